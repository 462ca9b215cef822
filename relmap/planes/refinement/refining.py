"""Refinement of wall submaps, each followed by its floor plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.adjoining import LEAST_SHARE, RIVAL, SIDE
from relmap.planes.linking.scan_links import ScanLinks
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import from_matrices, matrices
from relmap.planes.odometry.steps import steps_of
from relmap.planes.plan.floor_plan import floor_plan
from relmap.planes.refinement.refined_map import at_the_noise, refined_map, straightened
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.scans.beams import odds_over
from relmap.planes.submaps.grouped_map import GroupedMap
from relmap.planes.submaps.submap import WallSubmap, deviations
from relmap.planes.walls.assembly import WallNumbers
from relmap.planes.walls.history import PlaneHistory

STRAIGHTENED = 2
"""Maximum number of times that a refined submap is solved again since beams show it bent."""
FAR_M, FAR_RAD = 0.1, np.deg2rad(1.0)
"""Deviation of a step from its link above which it is examined."""


class RefinedWalls(NamedTuple):
    """Refined submaps, their association, and the history that they were computed from."""

    submaps: list[WallSubmap]
    numbers: WallNumbers
    history: PlaneHistory


def refined_submaps(grouped: GroupedMap, moving: Bools, links: ScanLinks) -> RefinedWalls:
    """Refine each submap by itself, from the poses given by the groups.

    The association is computed anew from the refined positions of walls: some merges based on
    drifted positions are wrong. A submap that cannot be refined is kept as chained.

    `moving` (p,): plane tracks ignored because they move; `links`: provides beams and odometry.
    """
    first = partial(grouped.submaps, grouped.at_rest(grouped.unmerged), moving)
    grouped = with_odometry(grouped, links, first)
    found = _refined(grouped, moving, links.scans)
    odometry = grouped.history.odometry
    if odometry and odometry.needed.any():  # estimated again, more accurately
        grouped = with_odometry(grouped, links, lambda: found.submaps)
        found = _refined(grouped, moving, links.scans)
    # Without beams no link was verified, and the chained map is as good as any part of it.
    submaps = [replace(one, torn=one.torn[: len(links.beams)]) for one in found.submaps]
    return RefinedWalls(submaps, found.numbers, found.history)


def planned_submaps(
    refined: RefinedWalls, moving: Bools, beams: BeamStore
) -> tuple[list[WallSubmap], WallNumbers, Ints]:
    """Return refined submaps with the walls of their floor plans, and their association.

    `moving` (p,): plane tracks ignored because they move; `beams`: remove walls that are seen
    through. Returns also the plane tracks (k,) that do not fit the submaps.
    """
    submaps, numbers, moved = list[WallSubmap](), refined.numbers, [np.empty(0, dtype=np.int64)]
    for submap in refined.submaps:
        plan, numbers, gone = floor_plan(submap, numbers, refined.history, beams, moving)
        submaps.append(replace(plan, torn=submap.torn))
        moved.append(gone)
    return submaps, numbers, np.concatenate(moved)


def _refined(grouped: GroupedMap, moving: Bools, scans: Scans) -> RefinedWalls:
    """Return the refined submaps."""
    numbers, submaps = grouped.at_rest(grouped.unmerged), list[WallSubmap]()
    history = grouped.history
    for submap in grouped.submaps(numbers, moving):
        found, own = refined_map(history, numbers, submap, moving)
        if found.refined:
            found, history = _straight(found, own, history, moving, scans)
            found, numbers = at_the_noise(found, history), own
        submaps.append(found)
    return RefinedWalls(submaps, numbers, history)


def _straight(
    submap: WallSubmap, numbers: WallNumbers, history: PlaneHistory, moving: Bools, scans: Scans
) -> tuple[WallSubmap, PlaneHistory]:
    """Return a refined submap with fewer of the bends that beams show, and the history with these.

    Solving again moves the whole submap a little: it is kept if fewer steps are bent then, and none
    of those that are held to their links.
    """
    bent = bent_steps(submap, history.motion, scans) if len(scans.beams) else np.empty(0, np.int64)
    for _ in range(STRAIGHTENED):
        if not len(bent):
            break
        more = replace(history, bent=np.union1d(history.bent, bent))
        found = straightened(more, numbers, submap, moving)
        if found is None:
            break
        left = bent_steps(found, more.motion, scans)
        if len(left) >= len(bent) or np.isin(left, more.bent).any():
            break
        submap, history, bent = found, more, left
    return submap, history


def on_odometry(links: ScanLinks, history: PlaneHistory) -> Bools:
    """Return which iterations (i,) depend on odometry for their motion.

    There, walls do not determine the motion in all directions.
    """
    weak = np.zeros(history.n_iterations, dtype=np.bool_)
    weak[history.weak_links] = True
    same = (np.diff(history.submap, prepend=-1) == 0) & (history.submap >= 0)
    known = np.isfinite(links.wheels.given.over(history.n_iterations)[:, 0, 0])
    known &= links.wheels.noise_over_all(links.motions, links.measured) is not None
    return np.asarray((weak | links.bridged | ~links.measured) & same & known)


def odometry_left_out(links: ScanLinks, history: PlaneHistory) -> Bools:
    """Return in which iterations (i,) odometry is rejected.

    There, walls measured another motion, or observations contradict it; all, if it is wrong too
    often.
    """
    known = np.isfinite(links.wheels.given.over(history.n_iterations)[:, 0, 0])
    broken = (np.diff(history.submap, prepend=history.submap[:1]) != 0) & known
    return np.asarray(links.wheels.left_out(links.motions, links.measured) | broken)


def with_odometry(
    grouped: GroupedMap, links: ScanLinks, submaps: Callable[[], Sequence[WallSubmap]]
) -> GroupedMap:
    """Return the map from the groups, with odometry unless there is none, or it is rejected.

    `submaps` are used to estimate its quality.
    """
    noise, history = links.wheels.noise_over_all(links.motions, links.measured), grouped.history
    if noise is None:
        return grouped
    given = links.wheels.given.over(history.n_iterations)
    given[odometry_left_out(links, history)] = np.nan
    paths = [(slice(*submap.span), submap.poses) for submap in submaps()]
    hanging = on_odometry(links, history)
    odometry = steps_of(noise, given, int(links.measured.sum()), paths, hanging)
    motion = odometry.lengthened(history.motion)
    return replace(grouped, history=replace(history, odometry=odometry, motion=motion))


def bent_steps(submap: WallSubmap, motions: Floats, scans: Scans) -> Ints:
    """Return the scans (t,) whose links beams prefer to the steps of a refined map into them.

    A short wall, or one that is taken for another, may turn a step by degrees, and all later scans
    with it. Two scans hardly show it: the beams of up to four scans before and four after the step
    are compared, as in `adjoining`, the later ones moved as a whole.
    """
    motions = motions[slice(*submap.span)]
    way_m, turn = deviations(submap.poses, motions)
    stepped = np.isfinite(submap.poses[:-1, 0, 3])
    far = 1 + np.flatnonzero(stepped & ((way_m > FAR_M) | (turn > FAR_RAD)))
    links = np.linalg.inv(matrices(motions[far]))
    changes = submap.poses[far - 1] @ links @ np.linalg.inv(submap.poses[far])
    bent = [
        _is_better(change, row, submap, scans)
        for row, change in zip(far.tolist(), changes, strict=True)
    ]
    return submap.first_iteration + far[np.array(bent, dtype=np.bool_)]


def _is_better(change: Floats, row: int, submap: WallSubmap, scans: Scans) -> bool:
    """Return whether beams prefer a change (4, 4) of the map from the scan of a row on."""
    poses, first = submap.poses, submap.first_iteration
    known = np.flatnonzero(np.isfinite(poses[:, 0, 3]))
    at = int(np.searchsorted(known, row))
    near = known[max(at - SIDE, 0) : at + SIDE].tolist()
    seen = {k: one for k in near if len(one := scans.beams_of(first + k))}
    pairs = list(product([k for k in seen if k < row], [k for k in seen if k >= row]))
    if not pairs:
        return False
    i, j = np.array(pairs).T
    moved = np.stack([poses[j], change @ poses[j]], axis=1)
    motions = from_matrices(np.linalg.inv(poses[i])[:, None] @ moved)
    both = ((seen[later], seen[earlier]) for earlier, later in pairs)
    odds, share = odds_over((*two, own) for two, own in zip(both, motions, strict=True))
    return bool(odds[0] > RIVAL and share[0] > LEAST_SHARE)
