"""Mapping of walls (section II)."""

from __future__ import annotations
