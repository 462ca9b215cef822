"""Placement of a scan in the map: hypotheses are fitted, scored by surfaces, and compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Floats, Ints, evenly
from relmap.planes3d.fitting import SHIFTED, fitted, fixes_turn, matched, ratios, repeats, shifts
from relmap.planes3d.hypotheses import Held, importance, motions
from relmap.planes3d.submap import Pose
from relmap.planes3d.surfaces import NEAR, Surfaces
from relmap.segmentation.space import Patches

JUDGED = 10
"""Number of hypotheses that are fitted: those with most surfaces near those of the map."""
HOPELESS = 0.7
"""Hypotheses with a smaller fraction of the best one's surfaces there are not fitted."""
SAMPLE, ROUGHLY = 400, 100
"""Number of cells of a scan that judge a placement, and that choose the hypotheses to fit."""
OVERLAP, NEAREST = 1.5, 4
"""Largest distance, in cells, of a cell of the scan from one of the map on the same surface, and
number of the nearest cells that are tried."""
GAIN = 0.02
"""Fraction of the surfaces that a shift must explain more: noise alone changes it by less."""
LEAST = 0.35
"""Minimum fraction of the scan's surfaces on surfaces of the map, of an accepted placement."""
RIVAL, RIVAL_LESS_ONE = 0.9, 0.6
"""A rival is a placement that explains at least this fraction of what the best one explains; the
second value holds if at most `FEW` planes match, or if the best one is a leap, and the rival misses
one of them, which may be new or match by chance: three planes at right angles match any others."""
FEW = 4
MOST = 0.75
"""If more than `BOX` planes match, a rival matches at least this fraction of their number."""
APART_RAD, APART = np.deg2rad(8.0), 0.05
"""Tolerance of placements that are the same: rotation, and translation over the range."""
CLOSE, SETTLES = 0.3, 0.85
"""A hypothesis this close to a placement, as a fraction of `APART`, is not fitted if the placement
explains at least the second value. So must a leap, unless more planes match than `BOX`: a room that
is a box, with something in it, looks much the same after half a turn."""
BOX = 8
SHORT, TURN_RAD = 5, np.deg2rad(90.0)
"""The first value replaces `BOX` for a leap that turns by less than the second and moves by less
than the range: in narrow rooms a turn by 40 degrees at a door moves points farther than that."""
UNMATCHED = 8.0
"""Tolerance of planes that another placement may explain, as a multiple of the usual one."""
ARRIVED = 0.05
"""A hypothesis that a fit brings this close to a placement, as a fraction of `APART`, is it."""
CLEARLY = 0.5
"""The chosen placement is at most this fraction as far from the expected one as any rival. It is
where steady motion leads if it is within this fraction of the standard deviation of that."""
LEAP = 1.0
"""A step longer than this fraction of the range is a leap; a rotation counts by how far it moves
points at the range."""


@dataclass(frozen=True, eq=False)
class Placed:
    """The pose of a scan, and the planes of the map that it shows.

    `R` (3, 3), `t` (3,): ``T_map_robot``. `match` (m,): the plane of the map that each plane of the
    scan matches; -1 for none. `share`: fraction of the scan's surfaces on surfaces of the map,
    reduced by their residuals. `free` (3,): the direction, map frame, in which planes determine the
    position poorly; None if there is none. `is_held`: whether the predicted position was used in
    that direction.
    """

    R: Floats
    t: Floats
    match: Ints
    share: float
    free: Floats | None
    is_held: bool

    def named(self, number: Ints) -> Placed:
        """Return the placement with matches given as numbers (k,) of the planes of the map."""
        return replace(self, match=np.where(self.match >= 0, number[self.match], -1))

    @property
    def pose(self) -> Pose:
        """Rotation and translation."""
        return self.R, self.t

    @property
    def n_planes(self) -> int:
        """Number of planes of the map that the scan shows."""
        return len(np.unique(self.match[self.match >= 0]))


def place(
    seen: Patches,
    planes: Patches,
    last: Pose | None,
    held: Held,
    is_doubtful: Callable[[Placed], bool] = lambda _: False,
    at_edges: Callable[[Placed], Placed] = lambda placed: placed,
) -> Placed | None:
    """Return the placement of a scan; None if none is accepted.

    `seen`: planes of the scan, robot frame. `planes`: of the map. `last`, R (3, 3) and t
    (3,): pose of the previous scan. Of placements that explain the scan equally well, as in a room
    that looks the same from two sides or beside parallel faces, the closest to where steady motion
    leads is accepted if the others are far. Without `last`, a placement with a rival is not
    accepted. `at_edges`: corrects an accepted one where it was predicted. `is_doubtful`: whether to
    refuse it; then those that match more planes, and explain nearly as much, are tried.
    """
    # A map seen from close by has small cells: in a grid of these a search would visit too many.
    there = Surfaces(planes, 2 * NEAR * max(planes.cell_m, seen.cell_m))
    best = _settled_all(seen, there, last, held)
    while best:
        placed = _chosen(best, seen, last, held)
        if placed is not None and placed.is_held:
            placed = at_edges(placed)
        if placed is None or not is_doubtful(placed):
            return placed
        least = RIVAL_LESS_ONE * best[0].share
        best = [each for each in best if each.share > least and each.n_planes > placed.n_planes]
    return None


def _chosen(best: list[Placed], seen: Patches, last: Pose | None, held: Held) -> Placed | None:
    """Return the accepted one of some placements, best first; parameters as of `place`."""
    if best[0].share < LEAST:
        return None
    first, reach_m, leap = best[0], seen.reach_m, LEAP * seen.reach_m
    if last is not None and moved_m(first.pose, last, reach_m) > leap:
        # In a room that looks the same from two sides a leap may explain a scan better by chance.
        near = [other for other in best if moved_m(other.pose, last, reach_m) <= leap]
        first = next((other for other in near if is_rival(other, first, True)), first)
        turn, way_m = apart(*first.pose, *last)
        most = BOX if turn > TURN_RAD or way_m > leap else SHORT
        if first is best[0] and first.share < SETTLES and first.n_planes <= most:
            return None
    rivals = _distinct([other for other in best if is_rival(other, first)], seen)
    if last is None:
        return first if len(rivals) == 1 else None
    return _closest(rivals, last[0], held, reach_m)


def _settled_all(seen: Patches, there: Surfaces, last: Pose | None, held: Held) -> list[Placed]:
    """Return the placements to which hypotheses lead, best first; parameters as of `place`."""
    found: list[Placed] = []
    tried = _promising(seen, there, held)
    # At the previous pose planes are matched to the nearest, as in the paper.
    for R, t in tried if last is None else [*tried, last]:
        if any(other.share > SETTLES and _same(R, t, other, seen, CLOSE) for other in found):
            continue
        placed = _settled((R, t), seen, there, held, found)
        if placed is not None:
            found.append(placed)
    best = max(found, key=lambda each: each.share, default=None)
    other = _otherwise(best, seen, there) if best else None
    # It may be one that was found already, from where it seemed to explain less.
    placed = _settled(other, seen, there, held, [], loose=1.0) if other else None
    if placed is not None:
        found.append(placed)
    found += _better(max(found, key=lambda each: each.share), seen, there, held) if found else []
    return sorted(found, key=lambda each: -each.share)


def _better(best: Placed, seen: Patches, there: Surfaces, held: Held) -> list[Placed]:
    """Return placements that explain more than the best one, which clutter misled: from shifts."""
    near = there.overlapping(*best.pose, seen)
    ways = shifts(*best.pose, seen, there.planes, near) + repeats(*best.pose, seen, there.planes)
    placed = [_settled((best.R, t), seen, there, held, [], loose=SHIFTED) for t in ways]
    return [each for each in placed if each is not None and each.share > best.share + GAIN]


def _otherwise(placed: Placed, seen: Patches, there: Surfaces) -> Pose | None:
    """Return the pose that the largest unmatched plane implies, if one of the map is near.

    What moves beside the sensor may determine a fit more accurately than a wall behind it.
    """
    near = there.overlapping(*placed.pose, seen)
    match, _ = matched(*placed.pose, seen, there.planes, near, UNMATCHED)
    left = np.flatnonzero((placed.match < 0) & (match >= 0))
    if not len(left):
        return None
    k = left[np.argmax(importance(seen)[left])]
    normal, offset = there.planes.normal[match[k]], there.planes.offset[match[k]]
    at = placed.R @ seen.centre[k] + placed.t
    return placed.R, placed.t + (offset - normal @ at) * normal


def _closest(rivals: list[Placed], R: Floats, held: Held, reach_m: float) -> Placed | None:
    """Return the placement closest to the expected pose; None if others are as close.

    `R` (3, 3): rotation of the previous scan, with which the predicted position is expected.
    """
    expected, leap = (R, held.place), LEAP * reach_m
    rivals.sort(key=lambda each: moved_m(each.pose, expected, reach_m))
    least = RIVAL * max((each.share for each in rivals if each.is_held), default=0.0)
    sure = [each for each in rivals if not each.is_held]
    # Planes that match by chance determine a position, too, but explain less.
    likely = [each for each in sure if each.share > least]
    chosen, others = (likely or rivals)[0], sure if likely else rivals
    step = moved_m(chosen.pose, expected, reach_m)
    # Constant motion is accepted if everything else is a leap.
    if step > leap and CLEARLY * step > moved_m(rivals[0].pose, expected, reach_m):
        return rivals[0]
    # Normals of two directions often match by chance.
    if chosen.is_held and step > leap:
        return None
    others = [each for each in others if each is not chosen]
    is_near = any(_is_near(chosen, other, expected, held, reach_m) for other in others)
    return None if is_near else chosen


def _is_near(chosen: Placed, other: Placed, expected: Pose, held: Held, reach_m: float) -> bool:
    """Return whether a placement is not much farther from the expected pose than the chosen one.

    Where both turn alike, and the chosen one is where steady motion leads, only their positions
    tell them apart.
    """
    way_m, other_m = (float(np.linalg.norm(each.t - held.place)) for each in (chosen, other))
    is_alike = apart(*chosen.pose, *other.pose)[0] < APART_RAD
    if not (is_alike and way_m < CLEARLY * held.off_m < np.inf):
        way_m, other_m = (moved_m(each.pose, expected, reach_m) for each in (chosen, other))
    return way_m > CLEARLY * other_m


def is_rival(other: Placed, best: Placed, is_leap: bool = False) -> bool:
    """Return whether a placement is a rival of the best one, which may be a leap."""
    if not is_leap and best.n_planes > BOX and other.n_planes < MOST * best.n_planes:
        return False
    doubtful = is_leap or best.n_planes <= FEW
    less = doubtful and other.n_planes >= best.n_planes - 1
    return other.share > (RIVAL_LESS_ONE if less else RIVAL) * best.share


def _distinct(placed: list[Placed], seen: Patches) -> list[Placed]:
    """Return the first of each group of placements that are the same."""
    chosen: list[Placed] = []
    for each in placed:
        if not any(_same(each.R, each.t, other, seen, 1.0) for other in chosen):
            chosen.append(each)
    return chosen


def _sample(seen: Patches, most: int) -> tuple[Floats, Ints, Floats]:
    """Return evenly chosen cells of a scan, their planes, and their weights, whose sum is 1."""
    rows = evenly(len(seen.cells), most)
    of = seen.cell_patch[rows]
    weight = (importance(seen) / np.maximum(np.bincount(of, minlength=len(seen)), 1))[of]
    return seen.cells[rows], of, weight / weight.sum()


def _promising(seen: Patches, there: Surfaces, held: Held) -> list[Pose]:
    """Return the hypotheses with most surfaces of a scan near surfaces that face the same way."""
    R, t = motions(seen, there.planes, held)
    cells, of, weight = _sample(seen, ROUGHLY)
    share = np.round(there.shares(R, t, seen, cells, of, weight), 9)
    order = np.argsort(-share, kind="stable")[:JUDGED]
    order = order[share[order] >= HOPELESS * share.max(initial=0.0)]
    return [(R[k], t[k]) for k in order]


def _settled(
    pose: Pose, seen: Patches, there: Surfaces, held: Held, known: list[Placed], loose: float = 4.0
) -> Placed | None:
    """Fit a hypothesis to its matches, three times, and judge it; None if it fails, or is known.

    `loose`: tolerance of the first matches, as a multiple of the usual one.
    """
    planes, near, (R, t) = there.planes, there.overlapping(*pose, seen), pose
    match, _ = matched(R, t, seen, planes, near, loose)
    for loose in (2.0, 1.0):
        if not fixes_turn(planes.normal[match[match >= 0]]):
            return None
        R, t, *_ = fitted((R, t), seen, planes, match, held)
        if any(_same(R, t, other, seen, ARRIVED) for other in known):
            return None
        # After the first fit the pose hardly changes.
        near = there.overlapping(R, t, seen) if loose > 1.0 else near
        match, off = matched(R, t, seen, planes, near, loose)
    if not fixes_turn(planes.normal[match[match >= 0]]):
        return None
    # Cells of the map on other planes, as of a floor below a shelf, do not support a match.
    fits = np.pad(ratios(R, t, seen, planes, near, 1.0) <= 1.0, ((0, 0), (0, 1)))
    R, t, free, is_held = fitted((R, t), seen, planes, match, held, last=True)
    fit = np.where(match >= 0, 1 - off**2, 0.0)
    cells, of, weight = _sample(seen, SAMPLE)
    reach = OVERLAP * max(planes.cell_m, seen.cell_m)
    overlap = fits[of[:, None], there.nearest(cells @ R.T + t, reach, NEAREST)].any(axis=1)
    return Placed(R, t, match, float((fit[of] * overlap) @ weight), free, is_held)


def _same(R: Floats, t: Floats, other: Placed, seen: Patches, share: float) -> bool:
    """Return whether two placements differ by less than a multiple of the tolerance."""
    turn, way = apart(R, t, other.R, other.t)
    return turn < share * APART_RAD and way < share * APART * seen.reach_m


def moved_m(a: Pose, b: Pose, reach_m: float) -> float:
    """Return the length of a step; a rotation counts by how far it moves points at the range."""
    turn, way = apart(*a, *b)
    return turn * reach_m + way


def apart(R: Floats, t: Floats, S: Floats, s: Floats) -> tuple[float, float]:
    """Return the rotation, radians, and the translation, metres, between two poses."""
    cosine = (np.trace(R @ S.T) - 1) / 2
    return float(np.arccos(np.clip(cosine, -1.0, 1.0))), float(np.linalg.norm(t - s))
