"""The odometry options of ``relmap simulate``, and the file of simulated odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    import numpy as np

    from relmap.core.arrays import Floats
    from relmap.datasets.scans import ScanLog
    from relmap.simulation.odometry import Wheels

Fault = Literal["slip", "reversed", "stale"]

SLIPS = 0.1
"""Fraction of steps that slipping wheels count twice."""
LATE_S, LATE_ITERATIONS = 0.5, 3.0
"""Delay of stale odometry, with and without a clock."""


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
        "--odometry",
        metavar="WAY:TURN",
        parser=pair,
        help="Write odometry.csv with errors of each step: WAY, a fraction of its length, and "
        "TURN, degrees; standard deviations, as 0.01:0.1.",
    ),
]
Bias = Annotated[
    Pair | None,
    typer.Option(
        "--odometry-bias",
        metavar="WAY:TURN",
        parser=pair,
        help="Systematic odometry errors: a fraction of the distance, and degrees to the left "
        "per metre.",
    ),
]
Broken = Annotated[
    Fault | None,
    typer.Option(
        "--odometry-fault",
        help="slip: a tenth of the steps counts twice; reversed: wrong sign; stale: 0.5 s "
        "late, or three iterations without a clock.",
    ),
]


@dataclass(frozen=True)
class OdometryOptions:
    """The ``--odometry`` options."""

    noise: Pair | None
    bias: Pair | None
    fault: Fault | None

    def wheels(self) -> Wheels | None:
        """Return the validated odometry noise; None without odometry.

        Raises `RelmapError` if a number is out of range, or a bias or fault is given without
        odometry.
        """
        from relmap.simulation.odometry import Wheels

        if self.noise is None:
            if self.bias or self.fault:
                raise RelmapError("--odometry-bias and --odometry-fault require --odometry")
            return None
        bias = self.bias or Pair(0.0, 0.0)
        wheels = Wheels(
            way=self.noise.way,
            turn_deg=self.noise.turn,
            way_bias=bias.way,
            turn_bias_deg_per_m=bias.turn,
        )
        wheels.check()
        return wheels


NONE = OdometryOptions(None, None, None)


def write_odometry(
    folder: Path, options: OdometryOptions, poses: Floats, stamps_s: Floats | None, seed: int
) -> int:
    """Write the odometry of a simulated path into a folder; return the number of files."""
    import numpy as np

    from relmap.datasets.odometry import write_odometry_csv
    from relmap.datasets.scans import ScanLog
    from relmap.simulation.odometry import wheel_odometry

    wheels = options.wheels()
    if wheels is None:
        return 0
    # A separate generator: the observations are the same with and without odometry.
    rng = np.random.default_rng([seed, len(poses)])
    odometry = wheel_odometry(poses, wheels, rng)
    at = np.arange(float(len(poses))) if stamps_s is None else stamps_s
    log = ScanLog(2, at, lambda _: np.empty((0, 2)), odometry=odometry)
    late = LATE_ITERATIONS if stamps_s is None else LATE_S
    faulty = _with_fault(log, options.fault, late, rng).odometry
    assert faulty is not None
    write_odometry_csv(folder / "odometry.csv", faulty)
    return 1


def _with_fault(
    log: ScanLog, fault: Fault | None, late: float, rng: np.random.Generator
) -> ScanLog:
    from relmap.simulation import faults

    if fault == "slip":
        return faults.slipping_wheels(log, SLIPS, rng)
    if fault == "reversed":
        return faults.reversed_odometry(log)
    return faults.stale_odometry(log, late) if fault else log
