"""Landmarks seen again: merging, place recognition, loops, and submaps that are tied."""
