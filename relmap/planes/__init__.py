"""Mapping of walls (section II)."""

from __future__ import annotations

from relmap.planes.mapper import PlaneMapper

__all__ = ["PlaneMapper"]
