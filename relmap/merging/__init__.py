"""Merging the maps of two runs with a unique alignment."""
