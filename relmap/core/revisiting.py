"""Merging of landmarks that a map with odometry contains twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation.coinciding import (
    CLEAR_SIGMAS,
    SIGMAS,
    TOLERANCE,
    gathered,
    lying_together,
    neighbours_fit,
    seen_with_both,
    within,
)
from relmap.core.association.reobservation.loops import TIED
from relmap.core.association.reobservation.merging import merge_doubles
from relmap.core.association.reobservation.recognition import CLEAR
from relmap.core.association.reobservation.revisits import RevisitFinder
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.scale import spacing_of
from relmap.core.gaps import bridge_gaps
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.chain.drift import Drift
from relmap.core.refinement.chain.resting import at_rest, placed_observations
from relmap.core.refinement.trend import by_landmark
from relmap.core.state.table import NONE, LandmarkState

SURE = 3.0
"""Standard deviations of the distance between two landmarks within which a neighbour may lie."""
SPACINGS = 2.0
"""Largest distance of landmarks that may coincide within the drift, in spacings."""
ROUNDS = 10
"""Maximum number of searches for revisits: each that is closed reduces the drift of others."""


def close_revisits(engine: RelativeMapper) -> None:
    """Merge the landmarks of revisited places and solve the map again, until none is found."""
    for _ in range(ROUNDS):
        surprises, alike = _merge_revisits(engine)
        if engine.odometry is None:
            return
        engine.odometry = replace(engine.odometry, alike=alike)
        if not surprises:
            return
        drift = float(np.sqrt(np.mean(np.square(surprises)) / engine.kept.location.shape[1]))
        engine.odometry = replace(engine.odometry, drift=max(drift, engine.odometry.drift))
        bridge_gaps(engine)


def _merge_revisits(engine: RelativeMapper) -> tuple[list[float], int]:
    """Merge the landmarks of all certain revisits; return the drift of each, in deviations.

    Also returns the number of landmarks that odometry tells apart from others that look the same.
    """
    surprises, table, alike = [], engine.table, 0
    sightings = Sightings(engine.rows, table)
    for refined in engine.refined:
        drift = Drift(refined.spread.problem, refined.spread.settled)
        landmarks = np.full(len(refined.spread.chosen), NONE)
        landmarks[refined.spread.chosen] = refined.landmarks
        finder = RevisitFinder(table, landmarks, drift, refined.noise_m)
        found = finder.revisits()
        alike += len(finder.alike)
        for revisit in found:
            pairs = table.now(revisit.pairs)
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            pairs = mergeable(table, sightings.apart(pairs))
            if len(pairs) > CLEAR * len(revisit.pairs):
                engine.merge_pairs(pairs)
                surprises.append(revisit.surprise)
    return surprises, alike


def mergeable(table: LandmarkState, pairs: Ints) -> Ints:
    """Return pairs (k, 2) with the landmark that was seen first in the second place.

    Each landmark is merged into one other at most, and not into one that is itself merged.
    """
    swap = table.first[pairs[:, 0]] < table.first[pairs[:, 1]]
    pairs = np.where(swap[:, None], pairs[:, ::-1], pairs)
    pairs = pairs[np.sort(np.unique(pairs[:, 0], return_index=True)[1])]
    return np.asarray(pairs[~np.isin(pairs[:, 1], pairs[:, 0])])


def merge_in_place(engine: RelativeMapper) -> None:
    """Merge landmarks that coincide in a map with odometry and were never seen together."""
    found = True
    sightings = Sightings(engine.rows, engine.table)
    while found and engine.refined:
        noise_m = max(refined.noise_m for refined in engine.refined)
        pairs = sightings.apart(lying_together(engine.table, noise_m))
        landmark, kept = engine.table.now(engine.kept.landmark), engine.kept
        both = seen_with_both(pairs, landmark, kept.iteration, len(engine.table))
        found = engine.merge_pairs(pairs[both >= TIED]) > 0


def merge_doubles_in_place(engine: RelativeMapper) -> None:
    """Merge landmarks that coincide, unless neighbours within the drift would fit as well."""
    table, noise_m = engine.table, engine.noise_m
    accuracy = _Accuracy(engine)

    def merge(placed: Ints) -> int:
        pairs = engine.merger.find(placed, noise_m)
        if not len(pairs):
            return 0
        others = np.setdiff1d(np.flatnonzero(table.weight > 0), pairs[:, 0])
        new, old = (table.position[of] for of in pairs.T)
        sd_m = accuracy.sd_m(pairs)
        reach_m = SURE * float(np.median(sd_m))
        if neighbours_fit(new, old, table.position[others], reach_m, TOLERANCE * noise_m):
            pairs = pairs[sd_m <= accuracy.needed_m]
        return engine.merge_pairs(pairs)

    if engine.refined:
        merge_doubles(engine, merge)


def merge_within_drift(engine: RelativeMapper) -> None:
    """Merge landmarks that coincide within the drift of the map, if no others might."""
    table, kept = engine.table, engine.kept
    own = np.flatnonzero((table.weight > 0) & (table.submap != NONE))
    if len(own) < 2 or not engine.refined:
        return
    scans: dict[int, set[int]] = {one: set() for one in own.tolist()}
    for one, scan in zip(table.now(kept.landmark).tolist(), kept.iteration.tolist(), strict=True):
        scans.get(one, set()).add(scan)
    at, chosen = table.position, []
    pairs = _nearest_pairs(own, at, scans)
    for pair, covariance in zip(pairs, _Accuracy(engine).covariances(pairs), strict=True):
        if not np.isfinite(covariance).all():
            continue
        others = np.setdiff1d(own, pair)
        rivals = [
            scans[one].isdisjoint(scans[other])
            for one in pair.tolist()
            for other in others[within(at[others] - at[one], covariance, CLEAR_SIGMAS)].tolist()
        ]
        if within((at[pair[0]] - at[pair[1]])[None], covariance, SIGMAS)[0] and not any(rivals):
            chosen.append(pair)
    engine.merge_pairs(mergeable(table, np.array(chosen, dtype=np.int64).reshape(-1, 2)))


def _nearest_pairs(own: Ints, at: Floats, scans: dict[int, set[int]]) -> Ints:
    """Return pairs (k, 2) of landmarks nearest to each other among those not seen together."""
    near = cKDTree(at[own]).query_pairs(SPACINGS * spacing_of(at[own]), output_type="ndarray")
    near = own[near]
    order = np.argsort(np.linalg.norm(at[near[:, 0]] - at[near[:, 1]], axis=1), kind="stable")
    found: list[tuple[int, int]] = []
    taken: set[int] = set()
    for one, other in near[order].tolist():
        if scans[one].isdisjoint(scans[other]):
            if taken.isdisjoint((one, other)):
                found.append((one, other))
            taken |= {one, other}
    return np.array(found, dtype=np.int64).reshape(-1, 2)


class _Accuracy:
    """Whether landmarks that coincide are one: where the map has drifted, they may be neighbours.

    `seen_in` (m,): an iteration in which each landmark was seen: one that is not mapped is as
    accurate as the pose, if that is in the first part.

    Attributes: `needed_m`: largest standard deviation of the distance of landmarks that are merged.
    """

    def __init__(self, engine: RelativeMapper, seen_in: Ints | None = None) -> None:
        table, use = engine.table, engine.odometry
        assert use is not None
        self.needed_m = spacing_of(table.position[table.weight > 0]) / SURE
        self._drift = use.drift
        self._parts = []
        for refined in engine.refined:
            problem, d = refined.spread.problem, refined.positions.shape[1]
            unknown = np.full((len(table), d), NONE)
            if seen_in is not None and refined is engine.refined[0]:
                pose = np.cumsum(np.isfinite(use.poses_in(engine.map.first)[:, 0, 0])) - 1
                unknown = problem.pose[pose[seen_in], -d:]
            unknown[refined.landmarks] = problem.unknown[refined.spread.chosen]
            self._parts.append((Drift(problem, refined.spread.settled), unknown))

    def sd_m(self, pairs: Ints) -> Floats:
        """Return the standard deviations (k,) of the distance of landmarks (k, 2), metres."""
        covariances = self.covariances(pairs)
        return np.asarray(np.sqrt(np.trace(covariances, axis1=1, axis2=2)))

    def covariances(self, pairs: Ints) -> Floats:
        """Return the covariances (k, d, d) of the difference of landmarks (k, 2), square metres.

        Infinite for landmarks of different parts.
        """
        d = self._parts[0][1].shape[1]
        found = np.tile(np.diag(np.full(d, np.inf)), (len(pairs), 1, 1))
        for drift, unknown in self._parts:
            both = (unknown[pairs, 0] != NONE).all(axis=1)
            found[both] = self._drift**2 * drift.between(unknown[pairs[both]])
        return found


def gather(engine: RelativeMapper) -> None:
    """Merge all landmarks of one object, mapped or not, once the poses are final."""
    table, kept = engine.table, engine.kept
    if engine.odometry is None or not engine.refined:
        return
    landmark = table.now(kept.landmark)
    places = placed_observations(kept, engine.odometry.poses_in(engine.map.first))
    mapped = table.weight > 0
    rests = mapped | at_rest(landmark, places, mapped)
    pieces = [(one, rows) for one, rows in by_landmark(landmark, places) if rests[one]]
    own = np.array([one for one, _ in pieces])
    middle = np.array([np.median(places[rows], axis=0) for _, rows in pieces])
    counts = np.array([kept.count[rows].sum() for _, rows in pieces])
    scans = [kept.iteration[rows] for _, rows in pieces]
    noise_m = max(refined.noise_m for refined in engine.refined)
    whole = own[gathered(middle, counts, scans, noise_m, spacing_of(table.position[mapped]))]
    became, oldest = np.arange(len(table)), np.arange(len(table))
    became[own] = whole
    known = np.bincount(whole, mapped[own], len(table)) > 0
    total = np.bincount(whole, counts, len(table))
    # Landmarks may belong to a moving object if none of them was mapped.
    known |= at_rest(became[landmark], places, mapped) & (total >= engine.config.group_after)
    latest_first = own[np.argsort(-table.first[own], kind="stable")]
    oldest[became[latest_first]] = latest_first  # the last of several stays
    pairs = np.column_stack([own, oldest[whole]])
    pairs = pairs[known[whole] & (pairs[:, 0] != pairs[:, 1])]
    seen_in = np.zeros(len(table), dtype=np.int64)
    seen_in[own] = [iterations[len(iterations) // 2] for iterations in scans]
    accuracy = _Accuracy(engine, seen_in)
    pairs = pairs[accuracy.sd_m(pairs) <= accuracy.needed_m]
    table.dynamic[pairs] = False
    table.take_off_map(np.unique(pairs))  # These have no position to average; they are solved for.
    engine.merge_pairs(pairs)
