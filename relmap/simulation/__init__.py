"""Simulated worlds with exact truth."""

from __future__ import annotations

from relmap.simulation.building import Building, building_scene, simulate_building
from relmap.simulation.figure_eight import FigureEight, simulate_figure_eight
from relmap.simulation.sensor import BuildingScan
from relmap.simulation.worlds import World, WorldSpec, simulate_world

__all__ = [
    "Building",
    "BuildingScan",
    "FigureEight",
    "World",
    "WorldSpec",
    "building_scene",
    "simulate_building",
    "simulate_figure_eight",
    "simulate_world",
]
