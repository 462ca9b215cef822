"""Ends of walls, and their types."""
