"""``relmap simulate``: simulate a world with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli import wheels
from relmap.cli.arguments import Density, Dynamic, Noise, Out, Seed
from relmap.cli.console import busy
from relmap.cli.simulate_storey import HELP as STOREY
from relmap.cli.simulate_storey import storey_command
from relmap.cli.worldfiles import write_building, write_points

if TYPE_CHECKING:
    from relmap.evaluation.sources import EightSource

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
Kind = Literal[
    "streets", "corridor", "ring", "field", "clumps", "columns", "line", "plane", "stairs"
]
Sensor = Literal["isotropic", "range", "bearing", "growing", "stereo"]

app = typer.Typer(
    help="""Simulate a robot in a world with known truth.

\b
Example:
  relmap simulate figure-eight -o eight
""",
    rich_markup_mode=None,
)

_FIGURE_EIGHT = """Simulate a flight past point landmarks.

It writes DIR/observations.csv (the observations, with the true identity of each landmark) and the
truth: DIR/truth/landmarks.csv and DIR/truth/trajectory.tum. The path is a figure eight of 740 m
that climbs and descends 40 m; a loop takes 900 iterations. With --odometry it also writes
DIR/odometry.csv.

\b
Examples:
  relmap simulate figure-eight -o eight --sigma 0.1
  relmap simulate figure-eight -o sparse --density 3 --odometry 0.01:0.1
"""

_WORLD = """Simulate landmarks that are hard to associate.

It writes DIR/observations.csv (observed ids, -1 for false detections) and the truth:
DIR/truth/landmarks.csv, DIR/truth/trajectory.tum and DIR/truth/ids.csv (the true landmark of each
row of the log).  The range of the sensor is 25 m.

\b
Example:
  relmap simulate world --kind corridor -o corridor --missed 0.3 --spurious 0.1
"""

_BUILDING = """Simulate a drive past the walls of a building.

It writes DIR/scans.npz (the points of every scan, robot frame; x and y only for a laser), a picture
building.png, and the truth: DIR/truth/planes.csv (one row per side of a wall) and
DIR/truth/trajectory.tum. The robot drives round a corridor lined with rooms, past their open doors,
in 250 to 310 scans per loop. The sensor has a range of 8 m and a field of view of 90 degrees
(laser: 180).

\b
Example:
  relmap simulate building -o building --sigma 0.1
"""


app.command("storey", help=STOREY)(storey_command)


@app.command("figure-eight", help=_FIGURE_EIGHT)
def figure_eight_command(
    out: Out,
    density: Density = 25.0,
    iterations: Annotated[int, typer.Option(help="Number of scans; one loop takes 900.")] = 900,
    noise: Noise = "gaussian",
    sigma: Annotated[
        float, typer.Option(help="Standard deviation of each observed coordinate, metres.")
    ] = 0.05,
    dynamic: Dynamic = 0.0,
    odometry: wheels.Noise = None,
    odometry_bias: wheels.Bias = None,
    odometry_fault: wheels.Broken = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated figure eight; the help text explains the arguments."""
    from relmap.evaluation.sources import EightSource

    source = EightSource(density, iterations, noise, sigma, dynamic, seed)
    counted = wheels.Counted(odometry, odometry_bias, odometry_fault)
    n_files = 3 if counted.wheels() is None else 4
    typer.echo(f"wrote {n_files} files to {out}: {write_figure_eight(out, source, counted)}")


def write_figure_eight(
    out: Path, source: EightSource, counted: wheels.Counted = wheels.NONE
) -> str:
    """Simulate the figure eight into a folder and return a line with counts.

    Raises
    ------
    RelmapError
        If a parameter is out of range or the folder cannot be written.
    """
    from relmap.io.files import staged_folder

    with staged_folder(out) as staging, busy("simulating"):
        data = source.load()
        assert data.truth is not None
        wheels.write_odometry(staging, counted, data.truth.poses, None, source.seed)
        return write_points(staging, data.log, data.truth)


@app.command("world", help=_WORLD)
def world_command(
    out: Out,
    kind: Annotated[Kind, typer.Option(help="The world and the path through it.")] = "streets",
    length: Annotated[float, typer.Option(help="Length of the path, metres.")] = 600.0,
    iterations: Annotated[int, typer.Option(help="Number of scans.")] = 400,
    spacing: Annotated[
        float, typer.Option(help="Typical distance of neighbouring landmarks, metres.")
    ] = 4.0,
    space: Annotated[
        bool, typer.Option("--space", help="Lift a planar world into three dimensions.")
    ] = False,
    sigma: Annotated[float, typer.Option(help="Noise of a coordinate, metres.")] = 0.05,
    noise: Annotated[
        Sensor,
        typer.Option(
            help="Noise model: the same in all directions; ten times larger in range or in "
            "bearing; growing with the range; or that of a stereo camera."
        ),
    ] = "isotropic",
    missed: Annotated[float, typer.Option(help="Fraction of the detections that fail.")] = 0.0,
    spurious: Annotated[
        float, typer.Option(help="False detections, as a fraction of the true ones.")
    ] = 0.0,
    wrong_ids: Annotated[float, typer.Option(help="Fraction of wrong ids.")] = 0.0,
    turn: Annotated[
        float, typer.Option(help="Degrees that the sensor turns to either side between scans.")
    ] = 0.0,
    view: Annotated[float, typer.Option(help="Width of the view, degrees.")] = 120.0,
    odometry: wheels.Noise = None,
    odometry_bias: wheels.Bias = None,
    odometry_fault: wheels.Broken = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated world; the help text explains the arguments."""
    from relmap.evaluation.sources import truth_of
    from relmap.io.files import atomic_write, staged_folder
    from relmap.io.tables import csv_text
    from relmap.simulation import WorldSpec, simulate_world

    spec = WorldSpec(
        kind=kind,
        length_m=length,
        iterations=iterations,
        spacing_m=spacing,
        space=space,
        sigma=sigma,
        noise=noise,
        missed=missed,
        spurious=spurious,
        wrong_ids=wrong_ids,
        turn_deg=turn,
        view_deg=view,
        seed=seed,
    )
    counted = wheels.Counted(odometry, odometry_bias, odometry_fault)
    counted.wheels()
    with staged_folder(out) as staging, busy("simulating"):
        world = simulate_world(spec)
        n_files = 4 + wheels.write_odometry(staging, counted, world.trajectory, None, seed)
        counts = write_points(staging, world.log, truth_of(world))
        ids = csv_text(("row", "landmark"), enumerate(world.true_ids.tolist()))
        atomic_write(staging / "truth" / "ids.csv", ids)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


@app.command("building", help=_BUILDING)
def building_command(
    out: Out,
    points: Annotated[
        int, typer.Option(help="Points per scan; with rays or laser, the number of beams.")
    ] = 2000,
    sigma: Annotated[
        float,
        typer.Option(
            help="Standard deviation of each coordinate, or of the range of beams, metres."
        ),
    ] = 0.05,
    noise: Noise = "gaussian",
    sampling: Annotated[
        Sampling,
        typer.Option(
            help="Points uniform on the visible surface, on a grid of beams, or on the beams of a "
            "2-D laser."
        ),
    ] = "surface",
    iterations: Annotated[
        int | None, typer.Option(help="Number of scans; by default as many as the loops take.")
    ] = None,
    loops: Annotated[int, typer.Option(help="How often the robot drives round.")] = 1,
    world: Annotated[
        World,
        typer.Option(help="The world."),
    ] = "building",
    moving: Annotated[
        int,
        typer.Option(help="Number of swinging doors; in panels, of moving panels."),
    ] = 0,
    beams: Annotated[
        int | None,
        typer.Option(help="A 2-D laser with this many beams; short for --sampling laser --points."),
    ] = None,
    view: Annotated[
        float | None, typer.Option(help="Field of view of the sensor, degrees, below 360.")
    ] = None,
    reach: Annotated[
        float | None, typer.Option("--range", help="Range of the sensor, metres.")
    ] = None,
    step: Annotated[
        float, typer.Option(help="Distance between scans, metres; turns scale with it.")
    ] = 0.22,
    people: Annotated[int, typer.Option(help="Laser only: number of people walking about.")] = 0,
    clutter: Annotated[
        float,
        typer.Option(help="Laser only: fraction of beams that hit small objects, up to 0.5."),
    ] = 0.0,
    odometry: wheels.Noise = None,
    odometry_bias: wheels.Bias = None,
    odometry_fault: wheels.Broken = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated building; the help text explains the arguments."""
    from relmap.io.files import staged_folder
    from relmap.simulation import simulate_building
    from relmap.simulation.sensor import sensor_of

    counted = wheels.Counted(odometry, odometry_bias, odometry_fault)
    counted.wheels()
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
        write_building(staging, building)
        way, stamps_s = building.trajectory, building.stamps_s
        n_files = 4 + wheels.write_odometry(staging, counted, way, stamps_s, seed)
    count = sum(len(scan.points) for scan in building.scans)
    typer.echo(
        f"wrote {n_files} files to {out}: {len(building.walls)} sides of walls, "
        f"{len(building.scans)} scans, {count} points"
    )
