"""Every method that can be compared, by name."""

from __future__ import annotations

import difflib

from relmap.comparison.baselines import (
    ekf,
    frame_to_frame,
    frame_to_map,
    gtsam_batch,
    isam2,
    kiss_icp,
    known,
    small_gicp,
)
from relmap.comparison.methods import relmap
from relmap.comparison.methods.base import MethodInfo
from relmap.core.errors import RelmapError
from relmap.evaluation.run import Association
from relmap.evaluation.sources import LogKind

METHODS: tuple[MethodInfo, ...] = (
    relmap.REFINED,
    relmap.LIVE,
    relmap.LITERAL,
    relmap.REFINED_PLANES,
    relmap.LIVE_PLANES,
    relmap.LITERAL_PLANES,
    frame_to_frame.METHOD,
    frame_to_map.METHOD,
    ekf.STANDING,
    ekf.FITTED,
    known.METHOD,
    isam2.METHOD,
    gtsam_batch.METHOD,
    kiss_icp.METHOD,
    small_gicp.METHOD,
)
"""In the order of the tables."""


def find_method(name: str) -> MethodInfo:
    """Return a method by its name.

    Raises
    ------
    RelmapError
        Where there is none of that name.
    """
    known = [method.name for method in METHODS]
    if name in known:
        return METHODS[known.index(name)]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    raise RelmapError(f"unknown method {name!r}; {hint}")


def fitting_methods(log: LogKind, association: Association) -> list[MethodInfo]:
    """Return the methods that a log of this kind can be given to."""
    return [
        method
        for method in METHODS
        if log in method.logs and (association == "known" or not method.needs_ids)
    ]


def check_method(method: MethodInfo, log: LogKind, association: Association) -> None:
    """Make sure that a method can be given such a log.

    Raises
    ------
    RelmapError
        Where it cannot.
    """
    if log not in method.logs:
        has = "point scans" if log == "scans" else "landmarks"
        fit = ", ".join(other.name for other in fitting_methods(log, association))
        raise RelmapError(f"method {method.name} cannot map a log of {has}; these can: {fit}")
    if method.needs_ids and association == "nearest":
        fit = ", ".join(other.name for other in fitting_methods(log, association))
        raise RelmapError(
            f"method {method.name} needs to be told which landmark is which: "
            f"--association known; without ids these can run: {fit}"
        )
