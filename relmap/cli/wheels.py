"""The odometry options of ``relmap simulate``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from relmap.cli.arguments import refuse
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.simulation.odometry import Wheels

Fault = Literal["slip", "reversed", "stale"]


class Pair(NamedTuple):
    """Two numbers, for translation and rotation."""

    way: float
    turn: float


def pair(text: str) -> Pair:
    """Return the two numbers in ``WAY:TURN``; RelmapError if it is not two finite numbers."""
    try:
        way, turn = map(float, text.split(":"))
    except ValueError:
        way = turn = math.nan
    if not math.isfinite(way + turn):
        raise RelmapError(f"{text!r} must be WAY:TURN, two numbers as in 0.01:0.1")
    return Pair(way, turn)


Noise = Annotated[
    Pair | None,
    typer.Option(
        metavar="WAY:TURN",
        parser=pair,
        help="Write odometry.csv with errors of each step: WAY, a fraction of its length, and "
        "TURN, degrees; standard deviations, as 0.01:0.1.",
    ),
]
Bias = Annotated[
    Pair | None,
    typer.Option(
        metavar="WAY:TURN",
        parser=pair,
        help="Systematic odometry errors: a fraction of the distance, and degrees to the left "
        "per metre.",
    ),
]
Broken = Annotated[
    Fault | None,
    typer.Option(
        help="slip: a tenth of the steps counts twice; reversed: wrong sign; stale: 0.5 s "
        "late, or three iterations without a clock.",
    ),
]


def wheels_of(noise: Pair | None, bias: Pair | None, fault: Fault | None) -> Wheels | None:
    """Return the errors of the odometry to simulate, as given; None without odometry.

    Raises `RelmapError` if a number is out of range, or a bias or fault is given without odometry.
    """
    from relmap.simulation.odometry import Wheels

    if noise is None:
        refuse(bias or fault, "--odometry-bias and --odometry-fault require --odometry")
        return None
    biases = {} if bias is None else {"way_bias": bias.way, "turn_bias_deg_per_m": bias.turn}
    wheels = Wheels(way=noise.way, turn_deg=noise.turn, **biases)
    wheels.check()
    return wheels
