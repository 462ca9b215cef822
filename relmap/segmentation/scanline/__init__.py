"""Walls in 2-D laser scans."""
