"""Rigid fits, rotations, and what lies near."""
