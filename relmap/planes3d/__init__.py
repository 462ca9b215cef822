"""Planes of any direction in space as landmarks, for a sensor that moves in six degrees."""

from __future__ import annotations

from relmap.planes3d.mapper import Plane3dMapper

__all__ = ["Plane3dMapper"]
