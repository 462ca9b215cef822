"""Which landmarks in view are older ones, by position and by the other landmarks in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import one_to_one
from relmap.core.association.placement import DISTINCT, consistent_placements
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.search import log_chance

ENOUGH = 3
"""Landmarks that a constellation needs; one more in space, where three also fit a mirror image."""
SHARE = 0.5
"""Fraction of the landmarks with candidates that must take part: drift is common to all."""
CANDIDATES = 60
"""Maximum number of pairs among which a constellation is searched."""
AVERAGED = 1.5
"""Tolerance of averaged positions, relative to that of observations."""
LOCAL_DRIFT = 0.1
"""Variance of the drift of the map within a group, relative to that of an observation."""
LOG_CHANCE = float(np.log(1e-3))
"""Log of the accepted expected number of false merges."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence for and against landmarks in view being older ones.

    `first` (k,), ascending: iteration in which each landmark in view was first seen, as far as
    known; `share`: probability that a landmark coincides with another by chance; `reach_m`:
    possible drift of the map; `weight`, `last` (n,): iterations averaged into the position of each
    landmark, and iteration in which it was last seen; `landmarks` (k,): those in view; `sightings`:
    which landmarks were seen together, if known.
    """

    first: Ints
    share: float
    reach_m: float
    weight: Floats
    last: Ints
    landmarks: Ints
    sightings: Sightings | None

    def sharpness(self, pairs: Ints) -> Floats:
        """Return the scatter of positions of pairs (k, 2), relative to an observation's (k,)."""
        variance = np.sum(1 / np.maximum(self.weight[pairs], 1), axis=1)
        return np.asarray(np.minimum(AVERAGED * np.sqrt(variance + LOCAL_DRIFT), 1.0))

    def tied(self, pairs: Ints) -> Bools:
        """Return which pairs (k, 2) are confirmed by others that were seen with both.

        Without sightings, by others that were in view when the older one was seen.
        """
        if self.sightings is not None:
            return self.sightings.seen_with_both(pairs, self.landmarks) >= ENOUGH
        return np.searchsorted(self.first, self.last[pairs[:, 1]], side="right") >= ENOUGH

    def is_unlike_chance(self, pairs: Ints, log_placements: float = 0.0) -> bool:
        """Return whether more pairs (k, 2) agree on one placement than chance explains."""
        later = len(self.first) - np.searchsorted(self.first, self.last[pairs[:, 1]].min(), "right")
        n = max(int(later), len(pairs))
        return log_chance(n, len(pairs), self.share, log_placements) <= LOG_CHANCE


def chosen(
    position: Floats, pairs: Ints, tolerance_m: float, evidence: Evidence | None = None
) -> Ints:
    """Return which of the pairs (k, 2) of landmarks are the same, by their mapped positions.

    Those that coincide; if none do, those of the largest set that one rigid motion brings together,
    because drift is common to all.

    `position` (n, d), map frame, metres: positions of all landmarks. `pairs` (k, 2): candidates: a
    new landmark, and an old one that it may be. `evidence`: the other landmarks in view; if
    omitted, coinciding pairs are accepted.
    """
    d = position.shape[1]
    apart = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    near = apart <= tolerance_m * (1.0 if evidence is None else evidence.sharpness(pairs))
    if near.any():
        on = one_to_one(pairs[near], apart[near])
        if evidence is None or evidence.is_unlike_chance(on):
            return on
        if evidence.tied(on).any():
            return on[evidence.tied(on)]
    pairs = pairs[:CANDIDATES]
    enough = max(ENOUGH + (d == 3), SHARE * len(np.unique(pairs[:, 0])))
    found = consistent_placements(position, position, pairs, tolerance_m)
    shift, pairs = next(found, (None, pairs))
    if shift is None or shift.n_agreeing < enough:
        return np.empty((0, 2), dtype=np.int64)
    _, rival = next(found, (None, pairs[:0]))
    off = np.linalg.norm(shift.apply(position[pairs[:, 0]]) - position[pairs[:, 1]], axis=1)
    pairs = pairs[off <= tolerance_m]
    pairs = pairs[~np.isin(pairs[:, 1], pairs[:, 0])]  # a merged landmark absorbs no other
    if evidence is not None:
        drifts = d * (d + 1) / 2 * np.log(1 + 2 * evidence.reach_m / tolerance_m)
        if len(rival) > DISTINCT * len(pairs) or not evidence.is_unlike_chance(pairs, drifts):
            return np.empty((0, 2), dtype=np.int64)
    return pairs
