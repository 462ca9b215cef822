"""Places that a map tied by odometry shows twice: found where its drift may have taken them.

Few landmarks are in view there, some seen once or twice, so triangles of neighbours find nothing.
How noisy odometry is bounds how far a place may be off, and so what may be what; the largest set
of candidate matches whose distances agree is believed where it is unlike chance and has no rival.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import bdtrc

from relmap.core.association.loops import TIED, Loop
from relmap.core.association.placement import consistent_placements
from relmap.core.association.tying import BY_CHANCE, CLEAR, NEIGHBOURHOOD, OVERLAP
from relmap.core.motion_noise import MotionNoise
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.table import NONE, LandmarkState

SOLID = 3
"""Observations without which a landmark says nothing of a place."""
FEWEST = 5
"""Matches below which a place is not looked at."""
SIGMAS = 3.0
"""How far off a place may be, in standard deviations of odometry over the way since."""
TOLERANCE = 5.0
"""How far apart the landmarks of two visits may lie, in standard deviations of an observation."""
APART = 2.5
"""How far off any other landmark must be, in the distance within which they are one."""
MOST_PAIRS = 800
"""Candidate matches that are looked at; where there are more, those that lie nearest."""


class RevisitFinder:
    """Finds revisits in a map, one after the other; each landmark is looked at once.

    Parameters
    ----------
    table : LandmarkState
    noise_m : float
        Standard deviation of an observed coordinate.
    noise : MotionNoise
        Of odometry, in each iteration.
    way_m : float
        Typical way from one iteration to the next, metres.
    """

    def __init__(
        self, table: LandmarkState, noise_m: float, noise: MotionNoise, way_m: float
    ) -> None:
        self._table = table
        self._tolerance_m = TOLERANCE * noise_m
        self._turn = noise.sigma_rad
        self._shift_m = float(np.hypot(noise.sigma_way * way_m, noise.sigma_m))
        self._had = np.zeros(len(table), dtype=bool)

    def next(self) -> Loop | None:
        """Return a revisit that is not known yet; None where no more are found."""
        table = self._table
        own = np.flatnonzero((table.submap != NONE) & (table.observations >= SOLID))
        for seed in own[np.argsort(table.since[own], kind="stable")].tolist():
            if not self._had[seed]:
                found = self._revisit(own[table.submap[own] == table.submap[seed]], seed)
                if found is not None:
                    return found
        return None

    def _revisit(self, own: NDArray[np.int64], seed: int) -> Loop | None:
        table = self._table
        in_view = table.since[own] <= table.last[seed]
        together = own[in_view & (table.last[own] >= table.since[seed])]
        apart = np.linalg.norm(table.position[together] - table.position[seed], axis=1)
        around = together[np.argsort(apart, kind="stable")[:NEIGHBOURHOOD]]
        self._had[around[: max(1, len(around) // OVERLAP)]] = True
        self._had[seed] = True
        new = around[table.since[around] == table.first[around]]
        if len(new) < FEWEST or len(around) - len(new) >= TIED:
            return None
        points, old = table.position[new], own[table.last[own] < table.since[new].min()]
        pairs, reach_m = self._candidates(new, old)
        if len(pairs) < FEWEST:
            return None
        there = table.position[old]
        fit_m = self._tolerance_m
        found = consistent_placements(points, there, pairs, fit_m, fit_m)
        best = next(found, None)
        if best is None or len(best[1]) < FEWEST:
            return None
        rival = next(found, None)
        n_rival = 0 if rival is None else len(rival[1])
        placement, matches = best
        if n_rival > CLEAR * len(matches) or not self._is_sure(points, there, reach_m, matches):
            return None
        return Loop(np.column_stack([new[matches[:, 0]], old[matches[:, 1]]]), placement)

    def _candidates(
        self, new: NDArray[np.int64], old: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], float]:
        """Return which may be which, as rows (p, 2), and how far off the place may be, metres."""
        table = self._table
        away = table.position[new][:, None] - table.position[old][None]
        apart = np.linalg.norm(away, axis=2)
        steps = (table.since[new][:, None] - table.last[old][None]).clip(0)
        between = table.position[own_between(table, old, new)] - table.position[new].mean(axis=0)
        lever_m = float(np.linalg.norm(between, axis=1).max(initial=0.0))
        drift_m = SIGMAS * np.sqrt(steps) * np.hypot(self._turn * lever_m, self._shift_m)
        near = np.argwhere(apart <= drift_m + self._tolerance_m)
        if len(near) > MOST_PAIRS:
            order = np.argsort(apart[near[:, 0], near[:, 1]], kind="stable")[:MOST_PAIRS]
            near = near[np.sort(order)]
        reach_m = float(drift_m[near[:, 0], near[:, 1]].max()) if len(near) else 0.0
        return near, reach_m

    def _is_sure(
        self,
        points: NDArray[np.float64],
        there: NDArray[np.float64],
        reach_m: float,
        matches: NDArray[np.int64],
    ) -> bool:
        """Tell whether chance hardly brings so many of the points (n, d) onto what was there."""
        d, tolerance_m = points.shape[1], self._tolerance_m
        middle = points.mean(axis=0)
        extent_m = float(np.linalg.norm(points - middle, axis=1).max())
        near = np.linalg.norm(there - middle, axis=1) <= reach_m + extent_m
        room = (2 * (reach_m + extent_m)) ** d
        share = min(1.0, near.sum() * (2 * tolerance_m) ** d / room)
        turns = max(1.0, 2 * np.pi * extent_m / tolerance_m) ** (2 * d - 3)
        trials = max(1.0, 2 * reach_m / tolerance_m) ** d * turns * len(self._had) / NEIGHBOURHOOD
        fixed = d
        chance = trials * float(bdtrc(len(matches) - fixed - 1, len(points) - fixed, share))
        return bool(chance <= BY_CHANCE)


def lying_together(table: LandmarkState, noise_m: float) -> NDArray[np.int64]:
    """Return pairs (k, 2) of landmarks, a newer and an older one, that lie in one place.

    Others near either lie much farther off.

    Parameters
    ----------
    table : LandmarkState
        Of a refined map.
    noise_m : float
        Standard deviation of an observed coordinate.
    """
    own = np.flatnonzero(table.submap != NONE)
    reach_m = TOLERANCE * noise_m
    tree = cKDTree(table.position[own])
    here, there = tree.query_pairs(APART * reach_m, output_type="ndarray").reshape(-1, 2).T
    alike = table.submap[own[here]] == table.submap[own[there]]
    here, there = here[alike], there[alike]
    near = np.linalg.norm(table.position[own[here]] - table.position[own[there]], axis=1) <= reach_m
    n = len(own)
    graph = coo_array((np.ones(near.sum()), (here[near], there[near])), shape=(n, n))
    place = connected_components(graph, directed=False)[1]
    crowded = np.zeros(n, dtype=bool)
    other = np.column_stack([place[here[~near]], place[there[~near]]])
    crowded[other[other[:, 0] != other[:, 1]].ravel()] = True
    order = np.lexsort((own, table.first[own], place))
    oldest = order[np.unique(place[order], return_index=True)[1]][place]
    newer = (np.arange(n) != oldest) & ~crowded[place]
    pairs: NDArray[np.int64] = np.column_stack([own, own[oldest]])[newer]
    return pairs


def seen_with_both(
    pairs: NDArray[np.int64], landmark: NDArray[np.int64], iteration: NDArray[np.int64], m: int
) -> NDArray[np.int64]:
    """Return how many others were seen about when each of pairs (k, 2) of landmarks was; (k,).

    Parameters
    ----------
    pairs : (k, 2) int64
    landmark, iteration : (n,) int64
        Of all observations.
    m : int
        Number of landmarks.
    """
    when = iteration // LENGTH
    ones = np.ones(len(landmark), dtype=np.int32)
    seen = coo_array((ones, (landmark, when)), shape=(m, int(when.max(initial=0)) + 1)).tocsr()
    seen.data[:] = 1
    with_new, with_old = (((seen[of] @ seen.T) > 0).astype(np.int32) for of in pairs.T)
    return np.asarray(with_new.multiply(with_old).sum(axis=1), dtype=np.int64).ravel()


def own_between(
    table: LandmarkState, old: NDArray[np.int64], new: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the landmarks that were first seen between some old ones and some new ones."""
    begin = table.last[old].min(initial=table.since[new].min())
    first, mapped = table.first, table.submap == table.submap[new[0]]
    return np.flatnonzero(mapped & (first >= begin) & (first <= table.since[new].max()))
