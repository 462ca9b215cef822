"""``relmap simulate``: make a world with a known truth."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from relmap.cli import simulate_building
from relmap.cli.arguments import (
    Density,
    Dynamic,
    Noise,
    OdometryBias,
    OdometryFault,
    OdometryNoise,
    Out,
    Seed,
    wheels_of,
)
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

_Kind = Annotated[
    Literal["streets", "corridor", "ring", "field", "clumps", "columns", "line", "plane", "stairs"],
    typer.Option(help="The world and the path through it."),
]
_Length = Annotated[float, typer.Option(help="Length of the path, metres.")]
_Iterations = Annotated[int, typer.Option(help="Number of scans.")]
_Spacing = Annotated[
    float, typer.Option(help="Typical distance of neighbouring landmarks, metres.")
]
_Space = Annotated[bool, typer.Option("--space", help="Lift a planar world into three dimensions.")]
_Sigma = Annotated[float, typer.Option(help="Noise of a coordinate, metres.")]
_Sensor = Annotated[
    Literal["isotropic", "range", "bearing", "growing", "stereo"],
    typer.Option(
        help="Noise model: the same in all directions; ten times larger in range or in bearing; "
        "growing with the range; or that of a stereo camera."
    ),
]
_Missed = Annotated[float, typer.Option(help="Fraction of the detections that fail.")]
_Spurious = Annotated[float, typer.Option(help="False detections, as a fraction of the true ones.")]
_WrongIds = Annotated[float, typer.Option(help="Fraction of wrong ids.")]
_Turn = Annotated[
    float, typer.Option(help="Degrees that the sensor turns to either side between scans.")
]
_View = Annotated[float, typer.Option(help="Width of the view, degrees.")]


@app.command("storey", help=_STOREY)
def storey_command(
    out: Out,
    sensor: Annotated[
        Literal["lidar", "depth"], typer.Option(help="Rings all around, or a depth camera.")
    ] = "lidar",
    sigma: Annotated[
        float, typer.Option(help="Noise of a range, metres; of the depth camera at a depth of 2 m.")
    ] = 0.01,
    iterations: Annotated[int, typer.Option(help="Scans.")] = 60,
    seed: Seed = 0,
    storeys: Annotated[int, typer.Option(help="1, or 2 with stairs.")] = 1,
    moving: Annotated[
        int, typer.Option(help="Boxes that are moved to and fro; the truth leaves them out.")
    ] = 0,
) -> None:
    """Write a simulated storey; the help text explains the arguments."""
    from relmap.cli.simulated import write_storey
    from relmap.io.files import staged_folder
    from relmap.simulation.storey import simulate_storey

    with staged_folder(out) as staging, busy("simulating"):
        storey = simulate_storey(sensor, sigma, iterations, seed, storeys, moving)
        write_storey(staging, storey)
    count = sum(map(len, storey.scans))
    typer.echo(f"wrote 3 files to {out}: {iterations} scans, {count} points")


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
    odometry: OdometryNoise = None,
    odometry_bias: OdometryBias = None,
    odometry_fault: OdometryFault = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated figure eight; the help text explains the arguments."""
    from relmap.cli.simulated import write_figure_eight
    from relmap.evaluation.sources import EightSource

    source = EightSource(density, iterations, noise, sigma, dynamic, seed)
    errors = wheels_of(odometry, odometry_bias, odometry_fault)
    n_files = 3 if errors is None else 4
    counts = write_figure_eight(out, source, errors, odometry_fault)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


@app.command("world", help=_WORLD)
def world_command(
    out: Out,
    kind: _Kind = "streets",
    length: _Length = 600.0,
    iterations: _Iterations = 400,
    spacing: _Spacing = 4.0,
    space: _Space = False,
    sigma: _Sigma = 0.05,
    noise: _Sensor = "isotropic",
    missed: _Missed = 0.0,
    spurious: _Spurious = 0.0,
    wrong_ids: _WrongIds = 0.0,
    turn: _Turn = 0.0,
    view: _View = 120.0,
    odometry: OdometryNoise = None,
    odometry_bias: OdometryBias = None,
    odometry_fault: OdometryFault = None,
    seed: Seed = 0,
) -> None:
    """Write a simulated world; the help text explains the arguments."""
    from relmap.cli.simulated import write_odometry, write_points
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
    errors = wheels_of(odometry, odometry_bias, odometry_fault)
    with staged_folder(out) as staging, busy("simulating"):
        world = simulate_world(spec)
        n_files = 4 + write_odometry(staging, errors, odometry_fault, world.trajectory, seed)
        counts = write_points(staging, world.log, truth_of(world))
        ids = csv_text(("row", "landmark"), enumerate(world.true_ids.tolist()))
        atomic_write(staging / "truth" / "ids.csv", ids)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


app.command("building", help=simulate_building.HELP)(simulate_building.building_command)
