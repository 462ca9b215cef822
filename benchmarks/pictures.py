"""The pictures of the documents, drawn from runs of relmap into docs/images.

    OMP_NUM_THREADS=1 python benchmarks/pictures.py DATA

DATA is a folder of the real data sets: the floor plan is that of Freiburg's building 079.  All
others are simulated.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap import PlaneMapper, PointMapper
from relmap.cli import main as relmap
from relmap.datasets import open_scans
from relmap.evaluation.feeding import feed
from relmap.plots.planes import draw_walls
from relmap.plots.sheet import BLUE, GREY, blank, draw_limits, limits_of, write_png
from relmap.simulation import simulate_figure_eight

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
LOG = "carmen-laser2d/freiburg-079-corrected.log.gz"
EVERY_SCAN, EVERY_BEAM = 10, 3
"""Subsampling of scans and beams, to keep the file small."""
FIGURES = {"05": "bench", "11": "group"}
"""Figures of `relmap figures`, and their names in the documents."""


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    IMAGES.mkdir(parents=True, exist_ok=True)
    write_png(IMAGES / "overview.png", lambda: _overview(data / LOG))
    with TemporaryDirectory() as folder:
        relmap(["figures", *map(str, map(int, FIGURES)), "--quick", "-o", folder])
        for number, name in FIGURES.items():
            shutil.copyfile(Path(folder) / f"figure{number}.png", IMAGES / f"{name}.png")


def _overview(path: Path) -> Figure:
    """Draw the points of a laser log, the floor plan made of them, and the figure eight."""
    figure = blank(11.5, 6.0, dpi=100)
    panels = figure.subplot_mosaic([["scan", "eight"], ["plan", "eight"]], width_ratios=[1.5, 1])
    _draw_building(panels["scan"], panels["plan"], path)
    _draw_eight(panels["eight"])
    for axes in panels.values():
        axes.set(ylabel="y [m]")
    panels["plan"].set(xlabel="x [m]")
    panels["eight"].set(xlabel="x [m]")
    return figure


def _draw_building(scans: Axes, plan: Axes, path: Path) -> None:
    log, mapper = open_scans(path), PlaneMapper()
    feed(mapper, log, "nearest", refine=True)
    poses = mapper.trajectory
    first = next(scan.points_robot for scan in log.scans())
    seen = []
    for scan, T in zip(log.scans(), poses, strict=True):
        if np.isfinite(T).all() and scan.iteration % EVERY_SCAN == 0:
            seen.append(scan.points_robot[::EVERY_BEAM] @ T[:2, :2].T + T[:2, 3])
    walls = mapper.planes.ends[mapper.planes.status == "static"]
    limits = limits_of(walls.reshape(-1, 2), poses[:, :2, 3], 1.0)
    scans.plot(*first.T, ".", color=BLUE, markersize=2)
    scans.plot(0, 0, "o", color=GREY)
    draw_limits(scans, limits)
    scans.set_title(f"one of {len(log)} laser scans of building 079, Freiburg", fontsize=11)
    plan.plot(*np.concatenate(seen).T, ",", color="#d0d0d0", zorder=1)
    draw_walls(plan, walls, width=1.2)
    draw_limits(plan, limits)
    plan.set_title(
        f"the map of all: {len(walls)} walls, no odometry (grey: points of the scans)", fontsize=11
    )


def _draw_eight(axes: Axes) -> None:
    world, mapper = simulate_figure_eight(), PointMapper()
    feed(mapper, world.log, "nearest", refine=True)
    places, path = mapper.map.positions[:, :2], mapper.trajectory[:, :2, 3]
    axes.plot(*path.T, color=GREY, linewidth=1.0)
    axes.plot(*places.T, ".", color=BLUE, markersize=4)
    draw_limits(axes, limits_of(places, path, 5.0))
    axes.set_title(f"simulated: {len(places)} point landmarks", fontsize=11)


if __name__ == "__main__":
    main()
