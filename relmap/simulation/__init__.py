"""Simulated worlds with exact truth."""

from __future__ import annotations

from relmap.simulation.building import Building, building_scene, simulate_building
from relmap.simulation.figure_eight import FigureEight, simulate_figure_eight
from relmap.simulation.sensor import BuildingScan

__all__ = [
    "Building",
    "BuildingScan",
    "FigureEight",
    "building_scene",
    "simulate_building",
    "simulate_figure_eight",
]
