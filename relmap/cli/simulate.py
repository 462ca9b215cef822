"""``relmap simulate``: make a world with a known truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli.arguments import Density, Dynamic, Noise, Out, Seed
from relmap.cli.console import busy

if TYPE_CHECKING:
    from relmap.evaluation.sources import EightSource
    from relmap.simulation import Building

Sampling = Literal["surface", "rays", "laser"]
World = Literal[
    "building",
    "panels",
    "long-wall",
    "oblique",
    "glass",
    "furniture",
    "twin-rooms",
    "corridor",
    "bare-corridor",
    "curved",
]

app = typer.Typer(
    help="""Simulate a robot in a world whose truth is known.

\b
Example:
  relmap simulate figure-eight -o eight
""",
    rich_markup_mode=None,
)

_FIGURE_EIGHT = """Simulate a robot flying past point landmarks.

It writes DIR/observations.csv (what the robot saw, with the true identity of each landmark) and
the truth: DIR/truth/landmarks.csv and DIR/truth/trajectory.tum.  The path is a figure eight of
740 m that climbs 40 m and comes down again; a loop takes 900 iterations.

\b
Example:
  relmap simulate figure-eight -o eight --sigma 0.1
"""

_BUILDING = """Simulate a robot that drives through a building and sees points of its walls.

It writes DIR/scans.npz (the points of every scan, in the robot's frame; of a laser x and y), a
picture building.png, and the truth: DIR/truth/planes.csv (every wall, once for each side it has)
and DIR/truth/trajectory.tum.  The robot drives round a corridor lined with rooms, past their open
doors, 250 to 310 scans a loop, and sees 8 m far in a view of 90 degrees (laser: 180).

\b
Example:
  relmap simulate building -o building --sigma 0.1
"""


@app.command("figure-eight", help=_FIGURE_EIGHT)
def figure_eight_command(
    out: Out,
    density: Density = 25.0,
    iterations: Annotated[
        int, typer.Option(help="How often the robot looks; one loop is 900.")
    ] = 900,
    noise: Noise = "gaussian",
    sigma: Annotated[
        float, typer.Option(help="Standard deviation of each coordinate seen, metres.")
    ] = 0.05,
    dynamic: Dynamic = 0.0,
    seed: Seed = 0,
) -> None:
    """Write a simulated figure eight; the help text explains the arguments."""
    from relmap.evaluation.sources import EightSource

    source = EightSource(density, iterations, noise, sigma, dynamic, seed)
    typer.echo(f"wrote 3 files to {out}: {write_figure_eight(out, source)}")


def write_figure_eight(out: Path, source: EightSource) -> str:
    """Simulate the figure eight into a folder and return a line of counts.

    Raises
    ------
    RelmapError
        Where a parameter is out of range or the folder cannot be written.
    """
    from relmap.datasets.observation_csv import write_observation_csv
    from relmap.evaluation.truth import write_truth
    from relmap.io.files import staged_folder

    with staged_folder(out) as staging, busy("simulating"):
        data = source.load()
        log, truth = data.log, data.truth
        assert truth is not None
        write_observation_csv(staging / "observations.csv", log)
        (staging / "truth").mkdir()
        write_truth(staging / "truth", truth)
    return (
        f"{len(truth.landmark_ids)} landmarks, {len(log)} iterations, "
        f"{len(log.points_robot)} observations"
    )


@app.command("building", help=_BUILDING)
def building_command(
    out: Out,
    points: Annotated[
        int, typer.Option(help="Points of a scan; with rays or laser the number of beams.")
    ] = 2000,
    sigma: Annotated[
        float,
        typer.Option(help="Standard deviation of each coordinate, of the range of beams; metres."),
    ] = 0.05,
    noise: Noise = "gaussian",
    sampling: Annotated[
        Sampling,
        typer.Option(
            help="How points lie: uniform on the visible surface, where a grid of beams meets "
            "it, or where the beams of a 2-D laser do."
        ),
    ] = "surface",
    iterations: Annotated[
        int | None, typer.Option(help="Number of scans; as the loops take if not given.")
    ] = None,
    loops: Annotated[int, typer.Option(help="How often the robot drives round.")] = 1,
    world: Annotated[
        World,
        typer.Option(help="Where it drives, as above."),
    ] = "building",
    moving: Annotated[
        int, typer.Option(help="Hang so many swinging doors; of panels, so many slide and turn.")
    ] = 0,
    beams: Annotated[
        int | None,
        typer.Option(help="Short for --sampling laser --points: a 2-D laser with so many beams."),
    ] = None,
    view: Annotated[
        float | None, typer.Option(help="Field of view of the sensor, degrees, below 360.")
    ] = None,
    reach: Annotated[
        float | None, typer.Option("--range", help="Range of the sensor, metres.")
    ] = None,
    step: Annotated[
        float, typer.Option(help="Way from one scan to the next, metres; turns go with it.")
    ] = 0.22,
    people: Annotated[int, typer.Option(help="So many people walk about; of a laser.")] = 0,
    clutter: Annotated[
        float, typer.Option(help="Share of the beams of a laser that meet small things, to 0.5.")
    ] = 0.0,
    seed: Seed = 0,
) -> None:
    """Write a simulated building; the help text explains the arguments."""
    from relmap.io.files import staged_folder
    from relmap.simulation import simulate_building
    from relmap.simulation.sensor import sensor_of

    if beams is not None:
        points, sampling = beams, "laser"
    with staged_folder(out) as staging, busy("simulating"):
        building = simulate_building(
            points,
            sigma,
            noise,
            sampling,
            iterations,
            seed,
            world,
            loops,
            sensor=sensor_of(sampling, view, reach),
            moving=moving,
            step_m=step,
            people=people,
            clutter=clutter,
        )
        _write_building(staging, building)
    count = sum(len(scan.points) for scan in building.scans)
    typer.echo(
        f"wrote 4 files to {out}: {len(building.walls)} sides of walls, "
        f"{len(building.scans)} scans, {count} points"
    )


def _write_building(folder: Path, building: Building) -> None:
    """Write a run into an existing folder."""
    import numpy as np

    from relmap.datasets import write_scans_npz
    from relmap.datasets.scans import SensorView
    from relmap.io.files import atomic_write, write_tum
    from relmap.io.tables import csv_text
    from relmap.plots.planes import write_building_png

    truth = folder / "truth"
    truth.mkdir()
    axes = slice(2 if building.scans[0].ranges_m is not None else 3)  # a laser scans the plane
    scans = [scan.points[:, axes] for scan in building.scans]
    view = SensorView(building.sensor.view_rad, building.sensor.range_m)
    write_scans_npz(folder / "scans.npz", scans, building.stamps_s, view)
    ends = ("plane", "x0", "y0", "x1", "y1", "z0", "z1")
    header = (*ends, "scans", "corner0", "corner1", "status", "seen0", "seen1")
    status = np.where(building.moving, "dynamic", "static").tolist()
    walls, seen = building.walls.tolist(), building.times_seen().tolist()
    columns = walls, seen, status, building.seen_extents().tolist()
    rows = [
        [number, *wall, *times, moves, *extent]
        for number, (wall, times, moves, extent) in enumerate(zip(*columns, strict=True))
    ]
    atomic_write(truth / "planes.csv", csv_text(header, rows))
    write_tum(truth / "trajectory.tum", building.stamps_s, building.trajectory)
    write_building_png(folder / "building.png", building)
