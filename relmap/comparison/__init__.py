"""Comparison of relmap with other methods, single runs and grids."""
