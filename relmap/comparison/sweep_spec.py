"""The specification of a sweep: a small TOML file that describes a grid of cells."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from typing import Any, get_args

from relmap.comparison.methods.registry import check_method, find_method
from relmap.core.errors import RelmapError, brief, known_name
from relmap.evaluation.feeding import Association
from relmap.evaluation.sources import BuildingSource, EightSource, Source
from relmap.simulation.figure_eight import LOOP_ITERATIONS
from relmap.simulation.noise import Noise

MOST_CELLS = 1_000_000
_LIMITS: dict[str, tuple[float, float, str]] = {
    "sigma": (0.0, 1e3, "0 to 1000 metres"),
    "density": (1e-3, 1e5, "0.001 to 100000"),
    "dynamic": (0.0, 1.0, "a fraction, 0 to 1"),
    "iterations": (0, 10**7, "0, for one loop, to 10000000"),
    "seed": (0, 2**63 - 1, f"0 to {2**63 - 1}"),
}
"""Smallest and largest value of a number, and a description of both."""
_CHOICES = {
    "world": ("figure-eight", "building"),
    "association": ("known", "nearest"),
    "noise": get_args(Noise),
}
_KINDS = {int: "a whole number", float: "a number", str: "a text"}


@dataclass(frozen=True)
class Cell:
    """One experiment: a world and a method.

    `world`: "figure-eight" or "building". `association`: "known" or "nearest". `noise`: "gaussian"
    or "uniform". `sigma`: metres. `density`: landmarks per 100 m; only for the figure eight.
    `dynamic`: fraction of moving landmarks; only for the figure eight. `iterations`: 0 for one
    loop.
    """

    world: str = "figure-eight"
    association: Association = "known"
    noise: Noise = "gaussian"
    sigma: float = 0.05
    density: float = 25.0
    dynamic: float = 0.0
    iterations: int = 0
    seed: int = 0
    method: str = "relmap-points"

    def source(self) -> Source:
        """Return the world."""
        if self.world == "building":
            return BuildingSource(self.iterations or None, self.noise, self.sigma, self.seed)
        loop = self.iterations or LOOP_ITERATIONS
        return EightSource(self.density, loop, self.noise, self.sigma, self.dynamic, self.seed)


KEYS = tuple(field.name for field in fields(Cell))
_DEFAULTS: dict[str, Any] = asdict(Cell())


def cells_of(spec: Mapping[str, Any]) -> list[Cell]:
    """Return all combinations of the values in a file, the last key of `Cell` changing fastest.

    `spec`: keys of `Cell`, each with a value, a list of values or, of whole numbers, a text ``A:B``
    for A to B - 1. Omitted keys have their defaults. Raises `RelmapError` if a key or a value is
    invalid, or a method does not accept such a world.
    """
    for key in spec:
        known_name(key, KEYS, "key")
    if "method" not in spec:
        raise RelmapError("no key method: which methods to run, as in method = ['relmap-points']")
    choices = [_choices(key, spec.get(key, _DEFAULTS[key])) for key in KEYS]
    count = math.prod(map(len, choices))
    if count > MOST_CELLS:
        raise RelmapError(f"the grid has {count} cells; the maximum is {MOST_CELLS}")
    if "building" in choices[KEYS.index("world")]:
        for key in ("density", "dynamic"):
            if key in spec:
                raise RelmapError(f"key {key} applies only to the figure eight, not to a building")
    cells = [Cell(*values) for values in itertools.product(*choices)]
    for world, association, method in sorted({(c.world, c.association, c.method) for c in cells}):
        walls = world == "building"
        if walls and association == "known":
            raise RelmapError("walls have no ids: a building needs association = 'nearest'")
        check_method(find_method(method), "scans" if walls else "landmarks", association)
    return cells


def _choices(key: str, given: Any) -> list[Any]:
    """Return the values of a key; RelmapError if there is none, or one is duplicated or invalid."""
    kind = type(_DEFAULTS[key])
    if kind is int and isinstance(given, str):
        numbers = re.fullmatch(r"(\d{1,18}):(\d{1,18})", given, re.ASCII)
        if not numbers:
            raise RelmapError(
                f"{key} is {brief(given)}; it must be whole numbers or A:B, for A to B - 1"
            )
        begin, end = int(numbers[1]), int(numbers[2])
        given = list(range(begin, min(end, begin + MOST_CELLS + 1)))
    values = [_value(key, kind, value) for value in (given if isinstance(given, list) else [given])]
    if not values or len(set(values)) < len(values):
        raise RelmapError(f"{key} is {brief(given)}; it must list distinct values, at least one")
    return values


def _value(key: str, kind: type, value: Any) -> Any:
    right = (int, float) if kind is float else kind
    if isinstance(value, bool) or not isinstance(value, right):
        raise RelmapError(f"{key} is {brief(value)}; it must be {_KINDS[kind]} or a list of such")
    said = ""
    with suppress(OverflowError):  # beyond any limit
        value = kind(value)
    if key in _CHOICES and value not in _CHOICES[key]:
        said = " or ".join(_CHOICES[key])
    if key in _LIMITS and not _LIMITS[key][0] <= value <= _LIMITS[key][1]:
        said = _LIMITS[key][2]
    if said:
        raise RelmapError(f"{key} is {brief(value)}; it must be {said}")
    return value


def varying(cells: Sequence[Cell]) -> list[str]:
    """Return the keys, except seed and method, in which cells differ."""
    others = [key for key in KEYS if key not in ("seed", "method")]
    return [key for key in others if len({getattr(cell, key) for cell in cells}) > 1]
