"""``relmap simulate``: make a world with a known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from relmap.cli.console import Out

Noise = Literal["gaussian", "uniform"]

app = typer.Typer(
    help="Simulate a robot in a world whose truth is known.",
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


@app.callback()
def _simulate() -> None:
    # Keeps figure-eight a name of its own although it is the only world so far.
    return


@app.command("figure-eight", help=_FIGURE_EIGHT)
def figure_eight_command(
    out: Out,
    density: Annotated[float, typer.Option(help="Landmarks per 100 m of the path.")] = 25.0,
    iterations: Annotated[
        int, typer.Option(help="How often the robot looks; one loop is 900.")
    ] = 900,
    noise: Annotated[Noise, typer.Option(help="Distribution of the noise.")] = "gaussian",
    sigma: Annotated[
        float, typer.Option(help="Standard deviation of each coordinate seen, metres.")
    ] = 0.05,
    dynamic: Annotated[float, typer.Option(help="Share of the landmarks that move, 0 to 1.")] = 0.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same world.")] = 0,
) -> None:
    """Write a simulated figure eight; the arguments are explained in the help text."""
    summary = write_figure_eight(out, density, iterations, noise, sigma, dynamic, seed)
    typer.echo(f"wrote 3 files to {out}: {summary}")


def write_figure_eight(
    out: Path,
    density: float = 25.0,
    iterations: int = 900,
    noise: Noise = "gaussian",
    sigma: float = 0.05,
    dynamic: float = 0.0,
    seed: int = 0,
) -> str:
    """Simulate the figure eight into a folder and return a line of counts.

    Raises
    ------
    RelmapError
        Where an argument is out of range or the folder cannot be written.
    """
    from relmap.cli.console import busy
    from relmap.datasets.observation_csv import write_observation_csv
    from relmap.evaluation.run import stamps_of
    from relmap.evaluation.truth import Truth, write_truth
    from relmap.files import staged_folder
    from relmap.simulation import simulate_figure_eight

    with staged_folder(out) as staging, busy("simulating"):
        world = simulate_figure_eight(density, iterations, noise, sigma, dynamic, seed)
        write_observation_csv(staging / "observations.csv", world.log)
        (staging / "truth").mkdir()
        truth = Truth(
            world.landmark_ids,
            world.landmarks_map,
            world.status,
            stamps_of(world.log),
            world.trajectory,
        )
        write_truth(staging / "truth", truth)
    return (
        f"{len(world.landmark_ids)} landmarks, {len(world.log)} iterations, "
        f"{len(world.log.points_robot)} observations"
    )
