"""Parts of a map, and where the robot goes from one into another."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints, evenly
from relmap.core.association.base import median_apart
from relmap.core.association.placement import Placement
from relmap.core.association.registering import BLIND
from relmap.core.association.reobservation.few import log_volume
from relmap.core.association.reobservation.recognition import SIGMAS
from relmap.core.map.pose import LOOSE_RAD
from relmap.core.scan import TINY

USUAL, SPEED = 0.95, 2.0
"""Fraction of the way that the robot covers in steps no longer than the usual one; and its speed
between two parts at most, relative to that."""
ALL_PAIRS, CROSSINGS = 10**6, 32
"""Number of pairs of landmarks of two parts above which these are not compared, and of places where
the robot goes from one into the other, of which evenly chosen ones count."""


@dataclass(frozen=True, eq=False)
class Part:
    """Some landmarks (m,) that were solved for together.

    `positions` (m, d), metres; `covariance`: returns that of rows (k,), (k d, k d); `noise_m`:
    standard deviation of an observed coordinate; the robot's way: `iterations` (p,), ascending,
    `places` (p, d), metres, and `turns` (p, d, d).
    """

    landmarks: Ints
    positions: Floats
    covariance: Callable[[Ints], Floats]
    noise_m: float
    iterations: Ints
    places: Floats
    turns: Floats

    @cached_property
    def log_density(self) -> float:
        """Log of the usual number of landmarks per volume."""
        d, spacing_m = self.positions.shape[1], median_apart(cKDTree(self.positions))
        return math.log(math.log(2)) - log_volume(d, max(spacing_m, TINY))


@dataclass(frozen=True, eq=False)
class Crossing:
    """Where the robot goes from one part into another: rows (c,) of its way, and its reach."""

    part: Part
    other: Part
    here: Ints
    there: Ints
    reach_m: float
    reach_rad: float

    @property
    def log_volume(self) -> float:
        """Log of the volume of the robot's possible motions, in metres and radians."""
        d = self.part.positions.shape[1]
        turns = log_volume(2 * d - 3, self.reach_rad)
        return log_volume(d, self.reach_m) + min(turns, log_turns(d))

    def within_reach(self, pairs: Ints) -> Ints:
        """Return those pairs (p, 2) of rows of landmarks that may be the same."""
        for here, there in zip(self.here.tolist(), self.there.tolist(), strict=True):
            own, its = (
                np.linalg.norm(of.positions - of.places[row], axis=1)
                for of, row in ((self.part, here), (self.other, there))
            )
            pairs = pairs[np.abs(own[pairs[:, 0]] - its[pairs[:, 1]]) <= self.reach_m]
        return pairs

    def allows(self, placement: Placement) -> bool:
        """Return whether a placement leaves the robot within its reach."""
        apart = placement.apply(self.part.places[self.here]) - self.other.places[self.there]
        turned = _angles(placement.R @ self.part.turns[self.here], self.other.turns[self.there])
        near = np.linalg.norm(apart, axis=1).max() <= self.reach_m
        return bool(near and turned.max() <= self.reach_rad)


def crossing_of(part: Part, other: Part, step_m: float, step_rad: float) -> Crossing | None:
    """Return where the robot goes from a part into another within the fewest iterations.

    `step_m`, `step_rad`: see `usual_steps`. None if that is never within reach.
    """
    gap = _gap(part.iterations, other.iterations)
    if gap > BLIND or len(part.landmarks) * len(other.landmarks) > ALL_PAIRS:
        return None
    each = [
        np.intersect1d(part.iterations + way, other.iterations, return_indices=True)[1:]
        for way in ((-1, 0, 1) if gap == 1 else (-gap, gap))
    ]
    here, there = (np.concatenate(rows) for rows in zip(*each, strict=True))
    rows = evenly(len(here), CROSSINGS)
    here, there = here[rows], there[rows]
    steps, tolerance_m = SPEED * gap, SIGMAS * max(part.noise_m, other.noise_m)
    reach_m = float(steps * step_m + tolerance_m)
    reach_rad = float(steps * step_rad + 2 * LOOSE_RAD)
    return Crossing(part, other, here, there, reach_m, reach_rad)


def usual_steps(parts: Sequence[Part]) -> tuple[float, float]:
    """Return the length of the longer steps between iterations, in metres, and their turn."""
    lengths, turns = [np.empty(0)], [np.empty(0)]
    for part in parts:
        next_one = np.diff(part.iterations) == 1
        lengths.append(np.linalg.norm(np.diff(part.places, axis=0), axis=1)[next_one])
        turns.append(_angles(part.turns[:-1], part.turns[1:])[next_one])
    return _usual(np.concatenate(lengths)), _usual(np.concatenate(turns))


def _usual(steps: Floats) -> float:
    """Return the step up to which steps (n,) sum up to nearly their total."""
    steps = np.sort(steps)
    covered = np.searchsorted(np.cumsum(steps), USUAL * steps.sum())
    return float(steps[covered]) if len(steps) else np.inf


def _angles(R: Floats, Q: Floats) -> Floats:
    """Return the angles (n,) between rotations (n, d, d), in radians."""
    cos = (np.einsum("nij,nij->n", R, Q) - (R.shape[1] - 2)) / 2
    return np.asarray(np.arccos(np.clip(cos, -1, 1)))


def log_turns(d: int) -> float:
    """Return the log of the volume of all rotations."""
    return math.log(2 * math.pi if d == 2 else 8 * math.pi**2)


def _gap(iterations: Ints, others: Ints) -> int:
    """Return the fewest iterations, at least 1, between those of two parts (p,), both ascending."""
    if not len(iterations) or not len(others):
        return BLIND + 1
    at = np.searchsorted(others, iterations)
    ends = np.clip([at - 1, at], 0, len(others) - 1)
    return max(int(np.abs(others[ends] - iterations).min()), 1)
