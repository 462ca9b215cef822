"""Mapping of point landmarks (section III)."""

from __future__ import annotations

from relmap.points.mapper import PointMapper

__all__ = ["PointMapper"]
