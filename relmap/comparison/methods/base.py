"""Descriptions of the methods that `relmap compare` can run."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from relmap.evaluation.sources import LogKind


@dataclass(frozen=True)
class Setup:
    """Information given to a method before it starts.

    `dimension`: 2 for a planar world, else 3; `sigma_m`: standard deviation of each observed
    coordinate, metres; `range_m`: distance of the farthest observation of the log, metres.
    """

    dimension: int = 3
    sigma_m: float = 0.05
    range_m: float = 80.0


@dataclass(frozen=True)
class MethodInfo:
    """A method and the information needed to choose it.

    `make`: makes a new `Method` or `Plane3dMapper`; `logs`: accepted kinds of logs; `refine`:
    whether the map is refined at the end of the log; `needs_ids`: whether it needs known ids;
    `needs`: module of the optional extra that it requires.
    """

    name: str
    make: Callable[[Setup], Any]
    logs: tuple[LogKind, ...] = ("landmarks",)
    refine: bool = False
    needs_ids: bool = False
    needs: str | None = None

    @property
    def missing(self) -> str | None:
        """Reason why it cannot run; None if nothing is missing."""
        if self.needs is None or importlib.util.find_spec(self.needs) is not None:
            return None
        return f"{self.needs} is not installed: pip install 'relmap[peers]'"
