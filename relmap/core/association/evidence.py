"""Which landmarks in view are older ones, judged by where they lie and by what else is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.placement import DISTINCT, consistent_placements
from relmap.core.association.search import log_chance

ENOUGH = 3
"""Landmarks that a constellation needs; one more in space, where three fit their mirror image."""
SHARE = 0.5
"""Share of the landmarks with candidates that must be in it: the drift is common to all."""
CANDIDATES = 60
"""Pairs that a constellation is looked for among."""
AVERAGED = 1.5
"""Tolerance of averages, in that of observations: less is lost by more of them."""
LOCAL_DRIFT = 0.1
"""Variance of what the map has drifted within a group, in those of an observation."""
LOG_CHANCE = float(np.log(1e-3))
"""Log of how often landmarks in view may be taken for others."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for and against landmarks in view being older ones.

    Attributes
    ----------
    first : (k,) int64, ascending
        When each landmark in view was seen first, as far as is known.
    share : float
        How likely a landmark lies on another one by chance.
    reach_m : float
        How far the map may have drifted.
    weight, last : (n,)
        Iterations averaged into the position of each landmark, and when it was seen last.
    """

    first: Ints
    share: float
    reach_m: float
    weight: Floats
    last: Ints

    def sharpness(self, pairs: Ints) -> Floats:
        """Return how much less than an observation the positions of pairs (k, 2) scatter (k,)."""
        variance = np.sum(1 / np.maximum(self.weight[pairs], 1), axis=1)
        return np.asarray(np.minimum(AVERAGED * np.sqrt(variance + LOCAL_DRIFT), 1.0))

    def tied(self, pairs: Ints) -> Bools:
        """Tell which pairs (k, 2) others in view tie to when the older landmark was seen."""
        return np.searchsorted(self.first, self.last[pairs[:, 1]], side="right") >= ENOUGH

    def is_unlike_chance(self, pairs: Ints, log_placements: float = 0.0) -> bool:
        """Tell whether so many pairs (k, 2) of one placement out of some are not by chance."""
        later = len(self.first) - np.searchsorted(self.first, self.last[pairs[:, 1]].min(), "right")
        n = max(int(later), len(pairs))
        return log_chance(n, len(pairs), self.share, log_placements) <= LOG_CHANCE


def chosen(
    position: Floats, pairs: Ints, tolerance_m: float, evidence: Evidence | None = None
) -> Ints:
    """Return which of the pairs (k, 2) of landmarks are one, by where they are mapped.

    Those that lie on one another; where none do, those of the largest set that one rigid motion
    brings together, for the drift is common to all.

    Parameters
    ----------
    position : (n, d) float64, map frame, metres
        Of all landmarks.
    pairs : (k, 2) int64
        Candidates: a new landmark, and an old one that it may be.
    tolerance_m : float
    evidence : Evidence, optional
        What else was in view; where it is not given, pairs that lie on one another are believed.
    """
    d = position.shape[1]
    apart = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    near = apart <= tolerance_m * (1.0 if evidence is None else evidence.sharpness(pairs))
    if near.any():
        on = _unique_nearest(pairs[near], apart[near])
        if evidence is None or evidence.is_unlike_chance(on):
            return on
        if evidence.tied(on).any():
            return on[evidence.tied(on)]
    pairs = pairs[:CANDIDATES]
    enough = max(ENOUGH + (d == 3), SHARE * len(np.unique(pairs[:, 0])))
    found = consistent_placements(position, position, pairs, tolerance_m, tolerance_m)
    shift, pairs = next(found, (None, pairs))
    if shift is None or shift.n_agreeing < enough:
        return np.empty((0, 2), dtype=np.int64)
    _, rival = next(found, (None, pairs[:0]))
    off = np.linalg.norm(shift.apply(position[pairs[:, 0]]) - position[pairs[:, 1]], axis=1)
    pairs = pairs[off <= tolerance_m]
    pairs = pairs[~np.isin(pairs[:, 1], pairs[:, 0])]  # what is merged away takes in nothing
    if evidence is not None:
        drifts = d * (d + 1) / 2 * np.log(1 + 2 * evidence.reach_m / tolerance_m)
        if len(rival) > DISTINCT * len(pairs) or not evidence.is_unlike_chance(pairs, drifts):
            return np.empty((0, 2), dtype=np.int64)
    return pairs


def _unique_nearest(pairs: Ints, distance: Floats) -> Ints:
    """Return the pairs (k, 2), the nearest first, of which no landmark was taken before."""
    unique: list[tuple[int, int]] = []
    taken: set[int] = set()
    for new, old in pairs[np.argsort(distance, kind="stable")].tolist():
        if new not in taken and old not in taken:
            unique.append((new, old))
            taken.update((new, old))
    return np.array(unique, dtype=np.int64).reshape(-1, 2)
