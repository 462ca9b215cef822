"""Planes of any direction as landmarks, for a sensor with six degrees of freedom."""

from __future__ import annotations

from relmap.planes3d.mapper import Plane3dMapper

__all__ = ["Plane3dMapper"]
