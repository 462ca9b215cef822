"""Merging of landmarks that a map with odometry contains twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.association.coinciding import lying_together, seen_with_both
from relmap.core.association.gathering import gathered
from relmap.core.association.loops import TIED
from relmap.core.association.revisits import RevisitFinder
from relmap.core.association.scale import spacing_of
from relmap.core.association.sightings import Sightings, rows_of_tracks
from relmap.core.association.tying import CLEAR
from relmap.core.gaps import bridge_gaps
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.drift import Drift
from relmap.core.refinement.resting import at_rest, by_landmark, placed_observations
from relmap.core.state.table import LandmarkState

ROUNDS = 10
"""Maximum number of searches for revisits: each that is closed reduces the drift of others."""


def close_revisits(engine: RelativeMapper) -> None:
    """Merge the landmarks of revisited places and solve the map again, until none is found."""
    for _ in range(ROUNDS):
        surprises = _merge_revisits(engine)
        if not surprises or engine.odometry is None:
            return
        drift = float(np.sqrt(np.mean(np.square(surprises)) / engine.kept.location.shape[1]))
        engine.odometry = replace(engine.odometry, drift=max(drift, engine.odometry.drift))
        bridge_gaps(engine, is_open=True)


def _merge_revisits(engine: RelativeMapper) -> list[float]:
    """Merge the landmarks of all certain revisits; return the drift of each, in deviations."""
    surprises, table = [], engine.table
    sightings = Sightings(rows_of_tracks(engine.rows, table), table)
    for refined in engine.refined:
        drift = Drift(refined.spread.problem, refined.spread.settled)
        finder = RevisitFinder(table, refined.landmarks, drift, refined.noise_m)
        for revisit in finder.revisits():
            pairs = table.now(revisit.pairs)
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            pairs = pairs[engine.merger.allowed(pairs)]
            apart = [not sightings.together(new, old) for new, old in pairs.tolist()]
            pairs = mergeable(table, pairs[np.array(apart, dtype=bool)])
            if len(pairs) > CLEAR * len(revisit.pairs):
                engine.merge_pairs(pairs)
                surprises.append(revisit.surprise)
    return surprises


def mergeable(table: LandmarkState, pairs: Ints) -> Ints:
    """Return pairs (k, 2) with the landmark that was seen first in the second place.

    Each landmark is merged into one other at most, and not into one that is itself merged.
    """
    swap = table.first[pairs[:, 0]] < table.first[pairs[:, 1]]
    pairs = np.where(swap[:, None], pairs[:, ::-1], pairs)
    pairs = pairs[np.sort(np.unique(pairs[:, 0], return_index=True)[1])]
    return np.asarray(pairs[~np.isin(pairs[:, 1], pairs[:, 0])])


def merge_in_place(engine: RelativeMapper, at_last: bool = False) -> None:
    """Merge landmarks that coincide in a map with odometry and were never seen together.

    With `at_last`, also those that were found to be distinct before but still coincide.
    """
    merger, found = engine.merger, True
    sightings = Sightings(rows_of_tracks(engine.rows, engine.table), engine.table)
    while found and engine.refined:
        noise_m = max(refined.noise_m for refined in engine.refined)
        pairs = lying_together(engine.table, noise_m)
        if not at_last:
            pairs = pairs[merger.allowed(pairs)]
        apart = [not sightings.together(new, old) for new, old in pairs.tolist()]
        pairs = pairs[np.array(apart, dtype=bool)]
        landmark, kept = engine.table.now(engine.kept.landmark), engine.kept
        both = seen_with_both(pairs, landmark, kept.iteration, len(engine.table))
        found = engine.merge_pairs(pairs[both >= TIED]) > 0


def gather(engine: RelativeMapper) -> None:
    """Merge all landmarks of one object, mapped or not, once the poses are final."""
    table, kept = engine.table, engine.kept
    if engine.odometry is None or not engine.refined:
        return
    landmark = table.now(kept.landmark)
    places = placed_observations(kept, engine.odometry.poses)
    mapped = table.weight > 0
    rests = mapped | at_rest(landmark, places, mapped)
    pieces = [(one, rows) for one, rows in by_landmark(landmark, places) if rests[one]]
    own = np.array([one for one, _ in pieces])
    middle = np.array([np.median(places[rows], axis=0) for _, rows in pieces])
    counts = np.array([len(rows) for _, rows in pieces])
    scans = [kept.iteration[rows] for _, rows in pieces]
    noise_m = max(refined.noise_m for refined in engine.refined)
    whole = own[gathered(middle, counts, scans, noise_m, spacing_of(table.position[mapped]))]
    became = np.arange(len(table))
    became[own] = whole
    known, total = np.zeros(len(table), dtype=bool), np.zeros(len(table), dtype=np.int64)
    np.logical_or.at(known, whole, mapped[own])
    np.add.at(total, whole, counts)
    # Landmarks of which none was mapped may belong to a moving object.
    known |= at_rest(became[landmark], places, mapped) & (total >= engine.config.group_after)
    oldest = np.arange(len(table))
    for one in own[np.argsort(-table.first[own], kind="stable")].tolist():
        oldest[became[one]] = one
    pairs = np.column_stack([own, oldest[whole]])
    pairs = pairs[known[whole] & (pairs[:, 0] != pairs[:, 1])]
    table.dynamic[pairs] = False
    table.take_off_map(np.unique(pairs))  # These have no position to average; they are solved for.
    engine.merge_pairs(pairs)
