"""Rigid fits, rotations and spatial search."""
