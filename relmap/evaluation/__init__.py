"""Evaluation of results: runs, metrics and the truth."""
