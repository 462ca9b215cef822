"""``relmap simulate storey``: a lidar or depth camera carried through rooms, or upstairs."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from relmap.cli.arguments import Out, Seed
from relmap.cli.console import busy

HELP = """Simulate a lidar or depth camera carried through rooms.

It writes DIR/scans.npz and the truth: DIR/truth/faces.csv (the corners of every face, its plane and
the area that two scans saw) and DIR/truth/trajectory.tum. Two rooms of a house have a floor, a
ceiling, a sloped roof, tables and cupboards; the sensor sways and tilts. With --storeys 2 it is
carried on up the stairs and through two rooms under a gable roof.

\b
Example:
  relmap simulate storey -o storey
  relmap map storey -o result --variant planes3d
"""


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
