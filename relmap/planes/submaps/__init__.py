"""Submaps: parts of a run without links, and where they are torn."""
