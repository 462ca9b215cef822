"""From the points of a scan to planes (section II)."""

from __future__ import annotations
