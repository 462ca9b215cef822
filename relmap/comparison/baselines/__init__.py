"""Baseline methods for the comparison."""
