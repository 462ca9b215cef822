"""``relmap simulate world``: landmarks that are hard to associate."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from relmap.cli import wheels
from relmap.cli.arguments import Out, Seed
from relmap.cli.console import busy

HELP = """Simulate landmarks that are hard to associate.

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
    odometry: wheels.Noise = None,
    odometry_bias: wheels.Bias = None,
    odometry_fault: wheels.Broken = None,
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
    errors = wheels.wheels_of(odometry, odometry_bias, odometry_fault)
    with staged_folder(out) as staging, busy("simulating"):
        world = simulate_world(spec)
        n_files = 4 + write_odometry(staging, errors, odometry_fault, world.trajectory, seed)
        counts = write_points(staging, world.log, truth_of(world))
        ids = csv_text(("row", "landmark"), enumerate(world.true_ids.tolist()))
        atomic_write(staging / "truth" / "ids.csv", ids)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")
