"""Refinement of a submap: plane adjustment, joining of landmarks, and uncertain steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats
from relmap.planes3d.adjustment import GAIN, PlaneAdjustment, Scene, Sightings
from relmap.planes3d.certainty import (
    plane_covariances,
    step_covariances,
    unreliable_steps,
    usual_steps,
)
from relmap.planes3d.fitting import OPEN, SYSTEMATIC, directed, distances
from relmap.planes3d.gathering import gathered
from relmap.planes3d.misled import comes_along, is_led_away, lies_beside, seen_through_steps
from relmap.planes3d.sights import BRIEF, is_dynamic, sights_of
from relmap.planes3d.submap import Submap
from relmap.planes3d.surfaces import SIDE, Surfaces
from relmap.segmentation.space import Patches

ROUNDS, ROUGHLY = 12, 0.1
"""Maximum number of rounds of adjusting and joining, and the gain that ends the adjustment while
landmarks are joined."""
FEW = 6
"""Number of scans of a submap of a broken run whose steps are too few to be compared."""
UNSURE = 0.0125
"""Standard deviation of an unsure step, as a fraction of the range."""
SMALL, LARGE = 0.04, 0.15
"""Extent of a landmark, the standard deviation of its points as a fraction of the range, below
which it may be a piece of a person if few scans saw it, and from which it does not move."""
ACROSS = 0.2
"""Cosine of a normal and a direction above which the plane shows where a scan is along it."""
MOVING = 1e-6
"""Weight of the observations of what moves: it holds a scan only where nothing else does."""
ONE = 2.0
"""Largest distance of two landmarks that are one plane, in standard deviations of their points."""
BENT, COVERED = 0.003, 0.5
"""Added to that distance, as a fraction of the range, because the map may be bent, if this fraction
of one surface lies at the other: a sensor does not see through either."""
MOVED = 0.05
"""Fraction of the range by which joined landmarks move a step at most: drift is shared by many."""


def refined(part: Submap, number: int) -> tuple[Submap, dict[int, int]]:
    """Return a submap adjusted to all its observations by least squares.

    `number`: of the first of the landmarks that are found in the points of all scans together.
    Returns `name`: new numbers of landmarks that were joined to others.
    """
    loose, unsure = _open_steps(part)
    part.weak = {k: directed(along[-1]) for k, along in loose.items()} | part.weak
    # A scan was placed with one such direction, which later ones may have determined since.
    free = {k: along[None] for k, along in part.weak.items() if k in unsure | part.held}
    free |= {k: along for k, along in loose.items() if k not in free or len(along) > 1}
    part, names = _settled(part, free, set(loose), ROUGHLY)
    part.sights = sights_of(part)
    more = gathered(part, number)
    part, later = _settled(part if more is None else more, free, set(loose), GAIN)
    names = {old: later.get(new, new) for old, new in names.items()} | later
    # The numbers of found landmarks that were joined to others are free again.
    return part, {old: new for old, new in names.items() if old < number}


def _settled(
    part: Submap, free: dict[int, Floats], loose: set[int], least_gain: float
) -> tuple[Submap, dict[int, int]]:
    """Adjust a submap and join landmarks that are one surface, in turns; see `refined`.

    `free`: iterations and the directions (k, 3), robot frame, in which their position is kept;
    `loose`: those of them whose step from the scan before is kept, as nothing else is known.
    """
    names: dict[int, int] = {}
    apart: set[tuple[int, int]] = set()
    part, gain = _adjusted(part, free, loose, ROUGHLY), ROUGHLY
    for _ in range(ROUNDS - 1):
        doubles = _doubles(part, apart)
        if not doubles and gain == least_gain:
            break
        gain = ROUGHLY if doubles else least_gain
        joined = part.again(part.poses, doubles) if doubles else part
        joined = _adjusted(joined, free, loose, gain)
        misled = _misled(part, joined, doubles)
        apart |= misled
        if not misled:
            part = joined
            names = {old: doubles.get(new, new) for old, new in names.items()} | doubles
    else:
        part = _adjusted(part, free, loose, least_gain)
    return part, names


def _misled(part: Submap, joined: Submap, doubles: dict[int, int]) -> set[tuple[int, int]]:
    """Return those of some joined landmarks that moved a step far, which the other ones contradict.

    They may be different surfaces, or one that the map shows tilted. `joined`: the submap with them
    joined, adjusted. Those count that the scans of such a step see.
    """
    R, t, S, s = (np.array(x) for each in (part, joined) for x in zip(*each.poses, strict=True))
    way, other = (np.einsum("nji,nj->ni", Q[:-1], np.diff(q, axis=0)) for Q, q in ((R, t), (S, s)))
    reach_m = np.array([seen.reach_m for seen in part.seen[1:]])
    rows = np.flatnonzero(np.linalg.norm(way - other, axis=1) > MOVED * reach_m)
    near = {n for k in rows for row in (k, k + 1) for n in part.number[part.match[row]].tolist()}
    return {pair for pair in doubles.items() if near & set(pair)}


def unsure_steps(part: Submap, is_broken: bool = False, quick_m: float = 0.0) -> dict[int, Floats]:
    """Return the iterations whose step from the scan before is poorly determined.

    A step is unsure if in some direction the standard deviation of the translation, or of the
    displacement by the rotation at the range, exceeds 1.25 % of the range. So is a step that is
    unsteady in a direction in which a single landmark determines it, unsteady by far, or unlike
    those around it, or turns so, see `relmap.planes3d.certainty`, or if a step near the usual ones
    explains more points, see `is_led_away`, or if its planes lie beside those of the scan before,
    see `lies_beside`, or if only small landmarks determine it and scans see through large ones, see
    `seen_through_steps`. Small landmarks that few scans saw do not count: people who walk ahead of
    the sensor make it seem to stand still. Nor do landmarks of any size that were seen only while
    it seemed to, see `comes_along`, unless it hardly ever moves.
    `is_broken`: whether there are other submaps; then so are all steps of a submap of at most six
    scans, as what broke the run before or after them may have misled them. `quick_m`: see
    `quick_step_m`.

    Each has the direction (3,) in which the translation is least certain, sensor frame.
    """
    seen, state, share = _observed(part)
    extent = _extents(part)
    walks = (part.n_scans <= BRIEF) & (extent < SMALL)
    if quick_m > UNSURE * part.reach_m:
        walks |= comes_along(part, quick_m)
    covariance = step_covariances(_without(seen, walks), state, share)
    turn_m2 = np.linalg.eigvalsh(covariance[:, :3, :3])[:, 2]
    way_m2, axes = np.linalg.eigh(covariance[:, 3:, 3:])
    reach_m = np.array([each.reach_m for each in part.seen])
    unsure = unreliable_steps(seen, state, share, np.array(part.iteration), reach_m)
    reach_m = np.minimum(reach_m[1:], reach_m[:-1])
    for variance in (turn_m2 * reach_m**2, way_m2[:, 2]):
        unsure |= variance > (UNSURE * reach_m) ** 2
    unsure |= is_broken and len(part.iteration) <= FEW
    covariance = step_covariances(_without(seen, extent < LARGE), state, share)[:, 3:, 3:]
    way_m2, way = np.linalg.eigh(covariance)
    lost = np.flatnonzero(way_m2[:, 2] > (UNSURE * reach_m) ** 2)
    unsure[seen_through_steps(part, extent >= LARGE, lost, way[lost, :, 2])] = True
    usual, gap = usual_steps(state.R, state.t, np.array(part.iteration)), np.diff(part.iteration)
    for k in np.flatnonzero(~unsure).tolist():
        unsure[k] = lies_beside(part, k + 1) or is_led_away(part, k + 1, gap[k] * usual[k][1:])
    rows = np.flatnonzero(unsure).tolist()
    return {part.iteration[k + 1]: directed(axes[k, :, 2]) for k in rows}


def _open_steps(part: Submap) -> tuple[dict[int, Floats], set[int]]:
    """Return the iterations whose step planes leave open, and in which directions (k, 3).

    The last is the least certain, robot frame. Least squares would let all that follows slide
    along them. Returns also the iterations whose step is unsure.
    """
    covariance = step_covariances(sightings(part), scene(part), SYSTEMATIC)
    variance, axes = np.linalg.eigh(covariance[:, 3:, 3:])
    reach_m = np.array([each.reach_m for each in part.seen[1:]])
    is_open = variance > ((OPEN * reach_m) ** 2)[:, None]
    rows = np.flatnonzero(is_open.any(axis=1)).tolist()
    unsure = np.array(part.iteration[1:])[variance[:, 2] > (UNSURE * reach_m) ** 2]
    return {part.iteration[k + 1]: axes[k].T[is_open[k]] for k in rows}, set(unsure.tolist())


def covariances_of(part: Submap) -> Floats:
    """Return the covariances (l, 4, 4) of the planes of a submap, see `plane_covariances`."""
    return plane_covariances(*_observed(part))


def _observed(part: Submap) -> tuple[Sightings, Scene, float]:
    """Return observations, poses and planes of a submap, and its error common to points."""
    return sightings(part), scene(part), SYSTEMATIC if part.share is None else part.share


def sightings(part: Submap) -> Sightings:
    """Return the observations of a submap; those of what moves hardly count."""
    scan = np.concatenate([np.full(len(seen), k) for k, seen in enumerate(part.seen)])
    columns = [
        np.concatenate([getattr(seen, name) for seen in part.seen])
        for name in ("centre", "axes", "information", "spread")
    ]
    seen = Sightings(scan, np.concatenate(part.match), *columns)
    return _without(seen, is_dynamic(part))


def _without(seen: Sightings, left_out: Bools) -> Sightings:
    """Return observations; those of some landmarks (l,) hardly count."""
    weight = np.where(left_out, MOVING, 1.0)[seen.plane]
    return replace(seen, information=weight[:, None] * seen.information)


def _extents(part: Submap) -> Floats:
    """Return the extents (l,) of landmarks as fractions of the range, see `SMALL`."""
    return np.asarray(np.sqrt(part.all_planes().spread[:, :2].prod(axis=1)) / part.reach_m)


def scene(part: Submap) -> Scene:
    """Return the current poses and planes of a submap."""
    planes = part.all_planes()
    R, t = (np.array(each) for each in zip(*part.poses, strict=True))
    return Scene(R, t, planes.normal.copy(), planes.centre, np.zeros(len(part)))


def _adjusted(part: Submap, free: dict[int, Floats], loose: set[int], least_gain: float) -> Submap:
    """Return a submap adjusted by least squares.

    `free`, `loose`: see `_settled`; `least_gain`: see `PlaneAdjustment.solve`.
    """
    seen, state, share = _observed(part)
    problem = PlaneAdjustment(seen, share, {part.iteration.index(k): free[k] for k in sorted(free)})
    state = problem.solve(state, least_gain)
    t = _kept(part, state, {k: free[k] for k in sorted(loose)})
    again = part.again(list(zip(state.R, t, strict=True)), {})
    again.share = problem.systematic_share(state)
    return again


def _kept(part: Submap, state: Scene, loose: dict[int, Floats]) -> Floats:
    """Return the adjusted positions (p, 3), with loose steps as they were along some directions.

    All that follows such a step moves with the scans before it: kept itself, it would be off by as
    much as these were. It does not if landmarks across the direction were seen on both sides.
    """
    first, last = part.spans
    moved, static = np.zeros_like(state.t), ~is_dynamic(part)
    for k, along in loose.items():
        row = part.iteration.index(k)
        tie = state.normal[(first < row) & (row <= last) & static] @ state.R[row]
        along = along[(np.abs(along @ tie.T) < ACROSS).all(axis=1)]
        (R, t), (_, before) = part.poses[row], part.poses[row - 1]
        change = R.T @ (t - before) - state.R[row].T @ (state.t[row] - state.t[row - 1])
        moved[row] = state.R[row] @ along.T @ along @ change
    return np.asarray(state.t + np.cumsum(moved, axis=0))


def _doubles(part: Submap, apart: set[tuple[int, int]]) -> dict[int, int]:
    """Return landmarks that are one surface with another of lower number, and that number.

    `apart`: pairs that are left as they are, the higher number first.
    """
    planes = part.all_planes()
    still, origin = np.eye(3), np.zeros(3)
    surfaces, off = Surfaces(planes), distances(still, origin, planes, planes)
    noise = np.hypot(planes.spread[:, None, 2], planes.spread[:, 2])
    bent_m = BENT * part.reach_m
    one = (off < ONE * noise) & surfaces.overlapping(still, origin, planes)
    maybe = (off < ONE * noise + bent_m) & (planes.normal @ planes.normal.T > SIDE)
    np.fill_diagonal(maybe, False)
    one = maybe & (one | (_covered(planes, maybe.any(axis=0) | maybe.any(axis=1)) > COVERED))
    a, b = np.nonzero(one)
    name: dict[int, int] = {}
    for k in np.argsort(off[a, b] / noise[a, b], kind="stable").tolist():
        low, high = sorted((int(part.number[a[k]]), int(part.number[b[k]])))
        # Landmarks that others were joined to are compared again before they are joined.
        known = low in name or high in name or high in name.values()
        if not known and (high, low) not in apart:
            name[high] = low
    return name


def _covered(planes: Patches, chosen: Bools) -> Floats:
    """Return which share (l, l) of the cells of each chosen landmark are at a cell of another."""
    mine, count = chosen[planes.cell_patch], len(planes)
    of, tree = planes.cell_patch[mine], cKDTree(planes.cells[mine])
    pairs = tree.query_pairs(planes.cell_m, output_type="ndarray")
    pairs = pairs[of[pairs[:, 0]] != of[pairs[:, 1]]]
    cell, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    # A cell counts once for each other landmark.
    cell, other = np.divmod(np.unique(cell * count + of[other]), count)
    covered = np.bincount(of[cell] * count + other, minlength=count**2).reshape(count, count)
    return covered / np.maximum(np.bincount(of, minlength=count), 1)[:, None]
