"""Simulated worlds with exact truth."""

from __future__ import annotations

from relmap.simulation.figure_eight import FigureEight, simulate_figure_eight

__all__ = ["FigureEight", "simulate_figure_eight"]
