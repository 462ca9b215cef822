"""``relmap simulate``: make a world with a known truth."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from relmap.cli import arguments as args
from relmap.cli.console import busy

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

_STOREY = """Simulate a lidar or depth camera carried through rooms.

It writes DIR/scans.npz and the truth: DIR/truth/faces.csv (the corners of every face, its plane and
the area that two scans saw) and DIR/truth/trajectory.tum. Two rooms of a house have a floor, a
ceiling, a sloped roof, tables and cupboards; the sensor sways and tilts. With --storeys 2 it is
carried on up the stairs and through two rooms under a gable roof.

\b
Example:
  relmap simulate storey -o storey
  relmap map storey -o result --variant planes3d
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


@app.command("storey", help=_STOREY)
def storey_command(
    out: args.Out,
    sensor: Annotated[
        Literal["lidar", "depth"], typer.Option(help="Rings all around, or a depth camera.")
    ] = "lidar",
    sigma: Annotated[
        float, typer.Option(help="Noise of a range, metres; of the depth camera at a depth of 2 m.")
    ] = 0.01,
    iterations: Annotated[int, typer.Option(help="Scans.")] = 60,
    seed: args.Seed = 0,
    storeys: Annotated[int, typer.Option(help="1, or 2 with stairs.")] = 1,
    moving: Annotated[
        int, typer.Option(help="Boxes that are moved to and fro; the truth leaves them out.")
    ] = 0,
) -> None:
    """Write a simulated storey; the help text explains the arguments."""
    from relmap.cli.simulated import ODOMETRY, write_storey
    from relmap.io.files import staged_folder
    from relmap.simulation.storey import simulate_storey

    with staged_folder(out, [ODOMETRY]) as staging, busy("simulating"):
        storey = simulate_storey(sensor, sigma, iterations, seed, storeys, moving)
        write_storey(staging, storey)
    count = sum(map(len, storey.scans))
    typer.echo(f"wrote 3 files to {out}: {iterations} scans, {count} points")


@app.command("figure-eight", help=_FIGURE_EIGHT)
def figure_eight_command(
    out: args.Out,
    density: args.Density = 25.0,
    iterations: Annotated[int, typer.Option(help="Number of scans; one loop takes 900.")] = 900,
    noise: args.Noise = "gaussian",
    sigma: Annotated[
        float, typer.Option(help="Standard deviation of each observed coordinate, metres.")
    ] = 0.05,
    dynamic: args.Dynamic = 0.0,
    odometry: args.OdometryNoise = None,
    odometry_bias: args.OdometryBias = None,
    odometry_fault: args.OdometryFault = None,
    seed: args.Seed = 0,
) -> None:
    """Write a simulated figure eight; the help text explains the arguments."""
    from relmap.cli.simulated import write_figure_eight
    from relmap.evaluation.sources import EightSource

    source = EightSource(density, iterations, noise, sigma, dynamic, seed)
    errors = args.wheels_of(odometry, odometry_bias, odometry_fault)
    n_files = 3 if errors is None else 4
    counts = write_figure_eight(out, source, errors, odometry_fault)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


@app.command("world", help=_WORLD)
def world_command(
    out: args.Out,
    kind: Annotated[
        Literal[
            "streets", "corridor", "ring", "field", "clumps", "columns", "line", "plane", "stairs"
        ],
        typer.Option(help="The world and the path through it."),
    ] = "streets",
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
        Literal["isotropic", "range", "bearing", "growing", "stereo"],
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
    odometry: args.OdometryNoise = None,
    odometry_bias: args.OdometryBias = None,
    odometry_fault: args.OdometryFault = None,
    seed: args.Seed = 0,
) -> None:
    """Write a simulated world; the help text explains the arguments."""
    from relmap.cli.simulated import ODOMETRY, write_odometry, write_points
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
    errors = args.wheels_of(odometry, odometry_bias, odometry_fault)
    with staged_folder(out, [ODOMETRY]) as staging, busy("simulating"):
        world = simulate_world(spec)
        n_files = 4 + write_odometry(staging, errors, odometry_fault, world.trajectory, seed)
        counts = write_points(staging, world.log, truth_of(world))
        ids = csv_text(("row", "landmark"), enumerate(world.true_ids.tolist()))
        atomic_write(staging / "truth" / "ids.csv", ids)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


@app.command("building", help=_BUILDING)
def building_command(
    out: args.Out,
    points: Annotated[
        int | None,
        typer.Option(
            help="Points per scan, 2000 by default; with rays or laser, the number of beams."
        ),
    ] = None,
    sigma: Annotated[
        float,
        typer.Option(
            help="Standard deviation of each coordinate, or of the range of beams, metres."
        ),
    ] = 0.05,
    noise: args.Noise = "gaussian",
    sampling: Annotated[
        Sampling | None,
        typer.Option(
            help="Points uniform on the visible surface (the default), on a grid of beams, or on "
            "the beams of a 2-D laser."
        ),
    ] = None,
    iterations: Annotated[
        int | None, typer.Option(help="Number of scans; by default as many as the loops take.")
    ] = None,
    loops: Annotated[int, typer.Option(help="How often the robot drives round.")] = 1,
    world: Annotated[World, typer.Option(help="The world.")] = "building",
    moving: Annotated[
        int, typer.Option(help="Number of swinging doors; in panels, of moving panels.")
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
        float, typer.Option(help="Laser only: fraction of beams that hit small objects, up to 0.5.")
    ] = 0.0,
    odometry: args.OdometryNoise = None,
    odometry_bias: args.OdometryBias = None,
    odometry_fault: args.OdometryFault = None,
    seed: args.Seed = 0,
) -> None:
    """Write a simulated building; the help text explains the arguments."""
    from relmap.cli.simulated import ODOMETRY, write_building, write_odometry
    from relmap.io.files import staged_folder
    from relmap.simulation import simulate_building
    from relmap.simulation.sensor import sensor_of

    wrong = view is not None and not 0 < view < 360
    args.refuse(wrong, f"--view is {view}; it must be above 0 and below 360 degrees")
    errors = args.wheels_of(odometry, odometry_bias, odometry_fault)
    if beams is not None:
        message = "--beams is short for --sampling laser --points: omit these"
        args.refuse(points is not None or sampling not in (None, "laser"), message)
        points, sampling = beams, "laser"
    points, sampling = 2000 if points is None else points, sampling or "surface"
    with staged_folder(out, [ODOMETRY]) as staging, busy("simulating"):
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
