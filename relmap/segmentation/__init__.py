"""Segmentation of the points of a scan into planes (section II)."""

from __future__ import annotations

from relmap.segmentation.planes import Planes
from relmap.segmentation.segmenter import PlaneSegmenter

__all__ = ["PlaneSegmenter", "Planes"]
