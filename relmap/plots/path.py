"""Aligning paths, and interrupting them where they are unknown."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.evaluation.metrics import align_poses, match_stamps
from relmap.evaluation.truth import Truth

GAP = 3.0
"""Gap between poses, in median intervals, above which the path is interrupted."""
JUMP = 5.0
"""Length of a step, in medians of the surrounding ones, that counts as a jump."""
AROUND = 5
"""Number of steps before and after with which each is compared."""
USUAL = 0.9
"""Steps up to `GAP` times this quantile of all steps are not jumps."""


def broken_at_gaps(stamps_s: Floats, position: Floats) -> Floats:
    """Return positions (k + gaps, d), with NaN in gaps of the times (k,)."""
    step_s = np.diff(stamps_s)
    usual_s = np.median(step_s) if len(step_s) else 0.0
    return _broken(position, step_s > GAP * usual_s)


def broken_at_jumps(position: Floats) -> Floats:
    """Return positions (k + jumps, d), with NaN where the path jumps, without times."""
    return _broken(position, jumps(position))


def split_at_jumps(position: Floats) -> list[Floats]:
    """Return positions (k, d) as the pieces (n, d) of the path between jumps."""
    return np.split(position, np.flatnonzero(jumps(position)) + 1)


def jumps(position: Floats) -> Bools:
    """Return for each step (k - 1,) between positions (k, d) whether the path jumps there."""
    step_m = np.linalg.norm(np.diff(position, axis=0), axis=1)
    if not len(step_m):
        return np.zeros(0, dtype=np.bool_)
    padded = np.pad(step_m, AROUND, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    most_m = np.maximum(JUMP * np.nanmedian(around, axis=1), GAP * np.quantile(step_m, USUAL))
    return np.asarray(step_m > most_m)


def _broken(position: Floats, gap: Bools) -> Floats:
    return np.insert(position, np.flatnonzero(gap) + 1, np.nan, axis=0)


def fit_to_truth(stamps_s: Floats, poses: Floats, truth: Truth) -> tuple[Floats, Floats] | None:
    """Return the planar motion that best aligns poses to the true ones of the same times.

    `stamps_s` (k,), seconds; `poses` (k, 4, 4): ``T_map_robot``. Returns `R` (2, 2), `t` (2,): as
    for `align_poses`; None if no times match.
    """
    mine, other = match_stamps(stamps_s, truth.stamps_s)
    return align_poses(poses[mine], truth.poses[other], 2) if len(mine) else None
