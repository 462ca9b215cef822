"""``relmap simulate``: make a world with a known truth."""

from __future__ import annotations

from typing import Annotated

import typer

from relmap.cli import simulate_building, simulate_storey, simulate_world, wheels
from relmap.cli.arguments import Density, Dynamic, Noise, Out, Seed

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

app.command("storey", help=simulate_storey.HELP)(simulate_storey.storey_command)


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
    from relmap.cli.simulated import write_figure_eight
    from relmap.evaluation.sources import EightSource

    source = EightSource(density, iterations, noise, sigma, dynamic, seed)
    errors = wheels.wheels_of(odometry, odometry_bias, odometry_fault)
    n_files = 3 if errors is None else 4
    counts = write_figure_eight(out, source, errors, odometry_fault)
    typer.echo(f"wrote {n_files} files to {out}: {counts}")


app.command("world", help=simulate_world.HELP)(simulate_world.world_command)
app.command("building", help=simulate_building.HELP)(simulate_building.building_command)
