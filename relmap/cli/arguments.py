"""Arguments shared by several verbs: logs, intervals, output folders, settings, odometry."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig
    from relmap.simulation.odometry import Wheels

Association = Literal["nearest", "known"]
Odometry = Literal["auto", "none"]
Level = Literal["auto", "none"]
Variant = Literal["points", "planes", "planes3d"]
Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        help="Format of INPUT, one that 'relmap map --help' lists; recognised if not given.",
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="NAME",
        help="The topic to read if a bag has several with scans, detections or odometry; may "
        "be given once for each of these.",
    ),
]
Noise = Annotated[
    Literal["gaussian", "uniform"], typer.Option(help="Distribution of the simulated noise.")
]
Density = Annotated[float, typer.Option(help="Figure eight only: landmarks per 100 m of the path.")]
Dynamic = Annotated[
    float, typer.Option(help="Figure eight only: fraction of moving landmarks, 0 to 1.")
]
Seed = Annotated[
    int, typer.Option(help="Seed of the random numbers: the same seed simulates the same world.")
]
Fault = Literal["slip", "reversed", "stale"]
OdometryFault = Annotated[
    Fault | None,
    typer.Option(
        help="slip: a tenth of the steps counts twice; reversed: wrong sign; stale: 0.5 s "
        "late, or three iterations without a clock.",
    ),
]


class Interval(NamedTuple):
    """Iterations ``begin`` to ``end - 1`` of a log, counted from 0."""

    begin: int
    end: int


def interval(text: str) -> Interval:
    """Return the interval given as ``A:B``, whole numbers with 0 <= A < B; else RelmapError."""
    numbers = re.fullmatch(r"(\d{1,18}):(\d{1,18})", text, re.ASCII)
    if numbers and int(numbers[1]) < int(numbers[2]):
        return Interval(int(numbers[1]), int(numbers[2]))
    raise RelmapError(f"--scans is {text!r}: it must be A:B, whole numbers with 0 <= A < B")


def columns(text: str) -> dict[str, str]:
    """Return the pairs given as ``ours=theirs,ours=theirs``.

    Raises `RelmapError` if it is not a list of pairs, or a column occurs twice.
    """
    pairs = [part.partition("=") for part in text.split(",")]
    found = {ours.strip(): theirs.strip() for ours, _, theirs in pairs}
    if len(found) < len(pairs) or not all(found.values()):
        raise RelmapError(f"--columns is {text!r}: it must be pairs like x=px,y=py,iteration=frame")
    return found


def folder(text: str, what: str = "a folder") -> Path:
    """Return the folder, or what else is expected, given by an argument.

    Raises `typer.BadParameter` if it is empty, for example because of an unset shell variable.
    """
    if not text:
        raise typer.BadParameter(f"it is empty, expected the name of {what}")
    return Path(text)


def log(text: str) -> Path:
    """Return the file or folder of a log; errors as for `folder`."""
    return folder(text, "a file or folder")


Log = Annotated[
    Path, typer.Argument(metavar="INPUT", parser=log, help="The log: a file or a folder.")
]
Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", parser=folder, help="Folder to write to.")
]
Scans = Annotated[
    Interval | None,
    typer.Option(
        metavar="A:B",
        parser=interval,
        help="Only iterations A to B - 1, counted from 0.",
    ),
]
Columns = Annotated[
    dict[str, str] | None,
    typer.Option(
        metavar="x=PX,y=PY,...",
        parser=columns,
        help="Column names of a table (CSV, Parquet) for iteration, stamp "
        "(seconds), x, y, z (or range, bearing, elevation) and id; others are ignored.",
    ),
]


def refuse(is_wrong: object, message: str) -> None:
    """Raise a `RelmapError` with the message, if arguments are incompatible or unknown."""
    if is_wrong:
        raise RelmapError(message)


def refuse_to_write_into(out: Path, *results: Path) -> None:
    """Raise a `RelmapError` if the output folder is a result folder that is only read."""
    for result in results:
        same = out.exists() and result.exists() and out.samefile(result)
        refuse(same, f"--out is {out}, an input, which is not changed: give another folder")


def read_config(
    path: Path | None, registration: str | None = None, unused: Mapping[str, str] | None = None
) -> MapperConfig:
    """Read a mapper's configuration from a TOML file; defaults without a file.

    `registration`: overrides the file; `unused`: settings that the run would ignore, with the
    reason. Raises `RelmapError` if the file cannot be read, is not TOML, or holds a setting that is
    unknown or would be ignored.
    """
    from relmap.core import config
    from relmap.io.files import read_toml

    given = {} if registration is None else {"registration": registration}
    if path is None:
        return config.MapperConfig.from_mapping(given)

    def parse(settings: dict[str, Any]) -> MapperConfig:
        config.refuse(settings, unused or {})
        return config.MapperConfig.from_mapping(settings | given)

    return read_toml(path, parse)


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


OdometryNoise = Annotated[
    Pair | None,
    typer.Option(
        metavar="WAY:TURN",
        parser=pair,
        help="Write odometry.csv with errors of each step: WAY, a fraction of its length, and "
        "TURN, degrees; standard deviations, as 0.01:0.1.",
    ),
]
OdometryBias = Annotated[
    Pair | None,
    typer.Option(
        metavar="WAY:TURN",
        parser=pair,
        help="Systematic odometry errors: a fraction of the distance, and degrees to the left "
        "per metre.",
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
    return Wheels(way=noise.way, turn_deg=noise.turn, **biases)
