"""``relmap simulate building``: the walls of a building, or of another world of walls."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from relmap.cli.arguments import (
    Noise,
    OdometryBias,
    OdometryFault,
    OdometryNoise,
    Out,
    Seed,
    refuse,
    wheels_of,
)
from relmap.cli.console import busy

HELP = """Simulate a drive past the walls of a building.

It writes DIR/scans.npz (the points of every scan, robot frame; x and y only for a laser), a picture
building.png, and the truth: DIR/truth/planes.csv (one row per side of a wall) and
DIR/truth/trajectory.tum. The robot drives round a corridor lined with rooms, past their open doors,
in 250 to 310 scans per loop. The sensor has a range of 8 m and a field of view of 90 degrees
(laser: 180).

\b
Example:
  relmap simulate building -o building --sigma 0.1
"""

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
_Points = Annotated[
    int | None,
    typer.Option(help="Points per scan, 2000 by default; with rays or laser, the number of beams."),
]
_Sigma = Annotated[
    float,
    typer.Option(help="Standard deviation of each coordinate, or of the range of beams, metres."),
]
_Sampling = Annotated[
    Sampling | None,
    typer.Option(
        help="Points uniform on the visible surface (the default), on a grid of beams, or on the "
        "beams of a 2-D laser."
    ),
]
_Iterations = Annotated[
    int | None, typer.Option(help="Number of scans; by default as many as the loops take.")
]
_Loops = Annotated[int, typer.Option(help="How often the robot drives round.")]
_World = Annotated[World, typer.Option(help="The world.")]
_Moving = Annotated[
    int, typer.Option(help="Number of swinging doors; in panels, of moving panels.")
]
_Beams = Annotated[
    int | None,
    typer.Option(help="A 2-D laser with this many beams; short for --sampling laser --points."),
]
_View = Annotated[
    float | None, typer.Option(help="Field of view of the sensor, degrees, below 360.")
]
_Reach = Annotated[float | None, typer.Option("--range", help="Range of the sensor, metres.")]
_Step = Annotated[float, typer.Option(help="Distance between scans, metres; turns scale with it.")]
_People = Annotated[int, typer.Option(help="Laser only: number of people walking about.")]
_Clutter = Annotated[
    float, typer.Option(help="Laser only: fraction of beams that hit small objects, up to 0.5.")
]


def building_command(
    out: Out,
    points: _Points = None,
    sigma: _Sigma = 0.05,
    noise: Noise = "gaussian",
    sampling: _Sampling = None,
    iterations: _Iterations = None,
    loops: _Loops = 1,
    world: _World = "building",
    moving: _Moving = 0,
    beams: _Beams = None,
    view: _View = None,
    reach: _Reach = None,
    step: _Step = 0.22,
    people: _People = 0,
    clutter: _Clutter = 0.0,
    odometry: OdometryNoise = None,
    odometry_bias: OdometryBias = None,
    odometry_fault: OdometryFault = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated building; the help text explains the arguments."""
    from relmap.cli.simulated import write_building, write_odometry
    from relmap.io.files import staged_folder
    from relmap.simulation import simulate_building
    from relmap.simulation.sensor import sensor_of

    wrong = view is not None and not 0 < view < 360
    refuse(wrong, f"--view is {view}; it must be above 0 and below 360 degrees")
    errors = wheels_of(odometry, odometry_bias, odometry_fault)
    if beams is not None:
        message = "--beams is short for --sampling laser --points: omit these"
        refuse(points is not None or sampling not in (None, "laser"), message)
        points, sampling = beams, "laser"
    points, sampling = 2000 if points is None else points, sampling or "surface"
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
        write_building(staging, building)
        way, stamps_s = building.trajectory, building.stamps_s
        n_files = 4 + write_odometry(staging, errors, odometry_fault, way, seed, stamps_s)
    count = sum(len(scan.points) for scan in building.scans)
    typer.echo(
        f"wrote {n_files} files to {out}: {len(building.walls)} sides of walls, "
        f"{len(building.scans)} scans, {count} points"
    )
