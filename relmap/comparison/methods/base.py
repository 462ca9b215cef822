"""Descriptions of the methods that `relmap compare` can run."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

from relmap.evaluation.feeding import Method
from relmap.evaluation.sources import LogKind


@dataclass(frozen=True)
class Setup:
    """What a method is given before it starts.

    Attributes
    ----------
    dimension : int
        2 for a planar world, else 3.
    sigma_m : float
        Standard deviation of each observed coordinate, metres.
    range_m : float
        Distance of the farthest observation of the log, metres.
    """

    dimension: int = 3
    sigma_m: float = 0.05
    range_m: float = 80.0


@dataclass(frozen=True)
class MethodInfo:
    """A method and what must be known to choose it.

    Attributes
    ----------
    name : str
    make : callable
        Makes a fresh one.
    logs : tuple of "landmarks", "scans"
        What it can be given.
    refine : bool
        Whether the map is refined when the log is over.
    needs_ids : bool
        Whether it needs known ids.
    needs : str or None
        Module of the optional extra that it is made of.
    """

    name: str
    make: Callable[[Setup], Method]
    logs: tuple[LogKind, ...] = ("landmarks",)
    refine: bool = False
    needs_ids: bool = False
    needs: str | None = None

    @property
    def missing(self) -> str | None:
        """What must be installed before it can run; None if nothing is missing."""
        if self.needs is None or importlib.util.find_spec(self.needs) is not None:
            return None
        return f"{self.needs} is not installed: pip install 'relmap[peers]'"
