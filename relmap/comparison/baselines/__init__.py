"""What people would use instead of relmap."""

from __future__ import annotations

from relmap.comparison.baselines.frame_to_map import FrameToMap

__all__ = ["FrameToMap"]
