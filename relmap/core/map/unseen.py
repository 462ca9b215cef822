"""Where a map is contradicted by what scans do not show: places that look alike, taken for one.

How often a landmark is seen depends on where the robot has it. This is learnt from the map itself:
of the landmarks at about the same place relative to the robot most are seen there, or few. Places
that were taken for one differ in some landmarks, and the scans of each miss those of the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import bdtrc

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import median_apart, nearest
from relmap.core.refinement.condensing import LENGTH, SegmentRows

FEWEST = 8
"""Landmarks of a submap that is examined."""
SPACINGS, LEAST, SIGMAS = 0.4, 3.0, 8.0
"""Distance within which an observation shows a landmark: in spacings, but from `LEAST` to `SIGMAS`
standard deviations of an observation."""
AROUND, SAMPLE = 25, 20_000
"""Number of places near another of which the fraction seen is taken, out of a sample."""
MOST = 500_000
"""Number of observations above which only some of the iterations are examined."""
IN_VIEW = 0.5
"""Fraction seen from which a place is in view."""
MISSED = 5.0
"""Expected number of observations of a landmark in view; without any it is missed."""
KNOWN = 0.5
"""Least fraction of the observations expected elsewhere that there are of a missed landmark."""
SHARE = 0.1
"""Fraction of the landmarks in view that is missed where a scan contradicts the map."""
USUAL, CLUMPED = 0.02, 1e3
"""Fraction of what should be in view that is missed otherwise above which landmarks are missed
together, as they hide each other or are removed; and how much more often as many are then."""
BY_CHANCE = 0.1
"""Accepted expected number of scans that miss as many, if landmarks are missed independently."""


class Part(NamedTuple):
    """A submap: positions (m, d), metres; iterations (p,) with a pose, and the poses (p, 4, 4)."""

    positions: Floats
    iterations: Ints
    poses: Floats


class _Had(NamedTuple):
    """Landmarks that the robot had within its reach, by landmark and iteration, ascending.

    Both (k,); the place relative to the robot (k, d), metres; and whether something was seen there.
    """

    landmark: Ints
    iteration: Ints
    place: Floats
    seen: Bools


class _InView(NamedTuple):
    """Landmarks that should be in view, by landmark and iteration (v,), and which are missed."""

    landmark: Ints
    iteration: Ints
    missed: Bools


def contradicting(rows: SegmentRows, parts: list[Part], noise_m: float) -> list[int | None]:
    """Return of each submap the iteration that contradicts it most, if one does.

    `rows`: of all iterations; `noise_m`: standard deviation of an observed coordinate.
    """
    row, scan = rows.sightings
    every = 1 + len(row) // MOST
    row, scan = row[scan % every == 0], scan[scan % every == 0]
    shown = np.einsum("nji,nj->ni", rows.R[scan], rows.points[row] - rows.t[scan])
    each = [_had(part, shown, scan, every, noise_m) for part in parts]
    places = np.concatenate([had.place for had in each])
    if len(places) < AROUND:
        return [None] * len(parts)
    sample = np.arange(0, len(places), 1 + len(places) // SAMPLE)
    tree, often = cKDTree(places[sample]), np.concatenate([had.seen for had in each])[sample]
    in_view = [_in_view(had, tree, often, every) for had in each]
    return [_least_likely(own, in_view) for own in in_view]


def _least_likely(own: _InView, every: list[_InView]) -> int | None:
    """Return the iteration that by chance misses as many landmarks of a submap least often.

    None if there is none that contradicts the map. `every`: of all submaps.
    """
    missing, in_view = np.bincount(own.iteration[own.missed]), np.bincount(own.iteration)
    if not len(missing):
        return None
    in_view = in_view[: len(missing)]
    n_scans = sum(len(np.unique(one.iteration)) for one in every)
    # How often others are missed does not depend on those missed here.
    usual = float(sum(one.missed.sum() for one in every))
    times = np.bincount(own.landmark[own.missed])[own.landmark[own.missed]]
    others = usual - np.bincount(own.iteration[own.missed], times)
    n_places = sum(len(one.missed) for one in every)
    share = (others + MISSED) / (n_places + 2 * MISSED)
    chance = n_scans / LENGTH * bdtrc(missing - 1.0, in_view, share)
    chance[others > USUAL * n_places] *= CLUMPED
    chance[missing < np.maximum(SHARE * in_view, 1)] = np.inf
    least = int(chance.argmin())
    return least if chance[least] <= BY_CHANCE else None


def _had(part: Part, shown: Floats, scan: Ints, every: int, noise_m: float) -> _Had:
    """Return which landmarks of a submap the robot had within its reach.

    `shown` (n, d), robot frame, metres: what each `scan` (n,), one in `every`, shows.
    """
    kept, d = part.iterations % every == 0, shown.shape[1]
    iterations, poses = part.iterations[kept], part.poses[kept]
    if len(part.positions) < FEWEST or not len(iterations):
        none = np.empty(0, dtype=np.int64)
        return _Had(none, none, np.empty((0, d)), np.empty(0, dtype=np.bool_))
    tree, robot = cKDTree(part.positions), poses[:, :d, 3]
    spacing_m = median_apart(tree)
    same_m = max(min(SPACINGS * spacing_m, SIGMAS * noise_m), LEAST * noise_m)
    doubles = tree.query_pairs(same_m, output_type="ndarray")[:, 1]
    positions = np.delete(part.positions, doubles, axis=0)
    reach_m = float(np.linalg.norm(shown, axis=1).max())
    near = cKDTree(positions).sparse_distance_matrix(cKDTree(robot), reach_m, output_type="ndarray")
    near = near[np.lexsort((near["j"], near["i"]))]
    landmark, at = near["i"].astype(np.int64), near["j"].astype(np.int64)
    place = np.einsum("nji,nj->ni", poses[at, :d, :d], positions[landmark] - robot[at])
    apart_m = 2 * (reach_m + same_m)  # by which scans are farther apart than any two places
    known = cKDTree(np.column_stack([shown, apart_m * scan]))
    asked = np.column_stack([place, apart_m * iterations[at]])
    seen = np.isfinite(known.query(asked, distance_upper_bound=same_m)[0])
    return _Had(landmark, iterations[at], place, seen)


def _in_view(had: _Had, tree: cKDTree, often: Bools, every: int) -> _InView:
    """Return which landmarks should be in view, and which of them are missed for too long.

    `tree`, `often` (s,): places of a sample, and whether landmarks there were seen.
    """
    expected, unseen = np.ones(len(had.seen)), np.flatnonzero(~had.seen)
    expected[unseen] = often[nearest(tree, had.place[unseen], AROUND)[1]].mean(axis=1)
    kept = expected >= IN_VIEW
    landmark, iteration, seen = had.landmark[kept], had.iteration[kept], had.seen[kept]
    other, later = np.diff(landmark, prepend=-1) != 0, np.diff(iteration, prepend=0)
    begins = other | (later > every * LENGTH)
    ends = np.append(begins[1:], True)[: len(begins)]
    run = np.cumsum(other | (np.diff(seen, prepend=False) != 0)) - 1
    within = np.bincount(run, every * expected[kept] * ~seen)
    # What is seen before and after it on the same visit was hidden; what is seen seldom elsewhere,
    # too, is missed for other reasons.
    outer = np.bincount(run, begins | ends) > 0
    elsewhere = np.bincount(landmark)[landmark] - np.bincount(run)[run]
    known = np.bincount(landmark, seen)[landmark] >= KNOWN * elsewhere
    missed = ((within >= MISSED) & outer)[run] & known
    return _InView(landmark, iteration, missed)
