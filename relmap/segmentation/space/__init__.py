"""Segmentation of clouds of a carried lidar or depth camera into planes of any direction."""

from __future__ import annotations

from relmap.segmentation.space.levelling import level_scan, vertical
from relmap.segmentation.space.patches import Patches
from relmap.segmentation.space.segmenter import PatchSegmenter

__all__ = ["PatchSegmenter", "Patches", "level_scan", "vertical"]
