"""Walls: all observations, which of them show one wall, and its line and extent."""
