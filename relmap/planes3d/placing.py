"""How a scan lies in the map: hypotheses are fitted, judged by surfaces, compared with rivals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes3d.fitting import NEAR, SIDE, Surfaces, fitted, fixes_turn, matched
from relmap.planes3d.hypotheses import Held, Motions, importance, motions
from relmap.segmentation.space import Patches

JUDGED = 10
"""Hypotheses that are fitted, those that lay most surfaces of the scan near those of the map."""
HOPELESS = 0.5
"""Those that lay a smaller share of what the best one does there are not."""
SAMPLE, ROUGHLY = 400, 150
"""Cells of a scan that judge, and that choose whom to judge."""
OVERLAP = 1.5
"""How far from a cell of the map a cell on the same plane is, in cells, that was seen before."""
LEAST = 0.35
"""Share of the scan's surfaces that lie on those of the map, of a placement that is believed."""
RIVAL, RIVAL_LESS_ONE = 0.9, 0.6
"""Share of the surface that a rival explains, of what the best does, which puts it in doubt; and
where it explains all planes but one of a few, which is new or matches by chance: three planes at
right angles match any others."""
FEW = 4
APART_RAD, APART = np.deg2rad(8.0), 0.05
"""Placements that differ by less are no rivals: a turn, and a way as a share of the range."""
CLOSE, SETTLES = 0.3, 0.85
"""Hypotheses within this share of that from a placement that explains so much come to the same."""
CLEARLY = 0.5
"""A rival is none where it takes a step so many times as long."""
LEAP = 1.0
"""A step longer than this share of the range is a leap; a turn counts by how far things move."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Where a scan was taken.

    Attributes
    ----------
    R : (3, 3) float64, t : (3,) float64
        ``T_map_robot``.
    match : (m,) int64
        The plane of the map that each plane of the scan is; -1 for none.
    share : float
        Of the scan's surfaces, those that lie on surfaces of the map, less where these are off.
    free : (3,) float64 or None
        The direction, map frame, in which planes hardly tell where it was; None where they do.
    is_held : bool
        Whether the scan was taken to go on as before in that direction.
    """

    R: Floats
    t: Floats
    match: Ints
    share: float
    free: Floats | None
    is_held: bool

    def named(self, number: Ints) -> Placed:
        """Return the placement with what the planes of the map (k,) are called for matches."""
        return replace(self, match=np.where(self.match >= 0, number[self.match], -1))

    @property
    def n_planes(self) -> int:
        """How many planes of the map the scan shows."""
        return len(np.unique(self.match[self.match >= 0]))


def place(
    seen: Patches, there: Surfaces, last: tuple[Floats, Floats] | None, held: Held
) -> Placed | None:
    """Return where a scan was taken; None where that is not believed.

    Parameters
    ----------
    seen : Patches
        Planes of the scan, robot frame.
    there : Surfaces
        Planes of the map.
    last : R (3, 3) and t (3,), optional
        Where the scan before was taken: of placements that explain as much, as in a room that looks
        the same from two sides, the next one is taken if the others are far; none without it.
    held : Held
    """
    best: list[Placed] = []
    tried = _promising(motions(seen, there.planes, held), seen, there)
    # Where the scan before was, planes are met by what is nearest, as in the paper.
    for R, t in tried if last is None else [*tried, last]:
        if any(other.share > SETTLES and _same(R, t, other, seen, CLOSE) for other in best):
            continue
        placed = _settled(R, t, seen, there, held)
        if placed is not None:
            best.append(placed)
    best.sort(key=lambda each: -each.share)
    if not best or best[0].share < LEAST:
        return None
    rivals = _distinct([other for other in best if _rivals(other, best[0])], seen)
    if last is None:
        return best[0] if len(rivals) == 1 else None
    rivals.sort(key=lambda each: _step(each, last, seen))
    sure = [each for each in rivals if not each.is_held]
    chosen, *others = sure or rivals
    step, leap = _step(chosen, last, seen), LEAP * seen.reach_m
    # To go on as before is no invention where all else is a leap.
    if step > leap and CLEARLY * step > _step(rivals[0], last, seen):
        return rivals[0]
    # Two directions match much by chance.
    if chosen.is_held and step > leap:
        return None
    return None if others and step > CLEARLY * _step(others[0], last, seen) else chosen


def _rivals(other: Placed, best: Placed) -> bool:
    """Tell whether a placement puts the best in doubt."""
    less = best.n_planes <= FEW and other.n_planes >= best.n_planes - 1
    return other.share > (RIVAL_LESS_ONE if less else RIVAL) * best.share


def _distinct(placed: list[Placed], seen: Patches) -> list[Placed]:
    """Return the first of all placements that are one."""
    chosen: list[Placed] = []
    for each in placed:
        if not any(_same(each.R, each.t, other, seen, 1.0) for other in chosen):
            chosen.append(each)
    return chosen


def _sample(seen: Patches, most: int) -> tuple[Floats, Ints, Floats]:
    """Return some of the cells of a scan, evenly, their planes, and what each counts; 1 in all."""
    rows = np.linspace(0, len(seen.cells) - 1, min(most, len(seen.cells))).astype(np.int64)
    of = seen.cell_patch[rows]
    weight = (importance(seen) / np.maximum(np.bincount(of, minlength=len(seen)), 1))[of]
    return seen.cells[rows], of, weight / weight.sum()


def _promising(tried: Motions, seen: Patches, there: Surfaces) -> list[tuple[Floats, Floats]]:
    """Return the hypotheses that lay most surfaces of a scan near those that look their way."""
    cells, of, weight = _sample(seen, ROUGHLY)
    points = np.einsum("hij,cj->hci", tried.R, cells) + tried.t[:, None]
    normal = np.einsum("hij,cj->hci", tried.R, seen.normal[of])
    reach = NEAR * max(there.planes.cell_m, seen.cell_m)
    plane = there.near(points.reshape(-1, 3), reach).reshape(points.shape[:2])
    side = np.einsum("hci,hci->hc", normal, there.planes.normal[plane]) > SIDE
    share = np.round(((plane >= 0) & side) @ weight, 9)
    order = np.argsort(-share, kind="stable")[:JUDGED]
    order = order[share[order] >= HOPELESS * share.max(initial=0.0)]
    return [(tried.R[k], tried.t[k]) for k in order]


def _settled(R: Floats, t: Floats, seen: Patches, there: Surfaces, held: Held) -> Placed | None:
    """Fit a hypothesis to what it matches, twice, and judge it."""
    match, _ = matched(R, t, seen, there, loose=4.0)
    for loose in (2.0, 1.0):
        if not fixes_turn(there.planes.normal[match[match >= 0]]):
            return None
        R, t, *_ = fitted(R, t, seen, there.planes, match, held)
        match, off = matched(R, t, seen, there, loose)
    if not fixes_turn(there.planes.normal[match[match >= 0]]):
        return None
    R, t, free, is_held = fitted(R, t, seen, there.planes, match, held, last=True)
    fit = np.where(match >= 0, 1 - off**2, 0.0)
    cells, of, weight = _sample(seen, SAMPLE)
    reach = OVERLAP * max(there.planes.cell_m, seen.cell_m)
    overlap = there.near(cells @ R.T + t, reach) >= 0
    return Placed(R, t, match, float((fit[of] * overlap) @ weight), free, is_held)


def _same(R: Floats, t: Floats, other: Placed, seen: Patches, share: float) -> bool:
    """Tell whether two placements are one, or no farther apart than a share of that."""
    turn, way = _apart(R, t, other.R, other.t)
    return turn < share * APART_RAD and way < share * APART * seen.reach_m


def _step(placed: Placed, last: tuple[Floats, Floats], seen: Patches) -> float:
    """Return how long a step it takes from the last placement: turn times range, and way."""
    turn, way = _apart(placed.R, placed.t, *last)
    return turn * seen.reach_m + way


def _apart(R: Floats, t: Floats, S: Floats, s: Floats) -> tuple[float, float]:
    cosine = (np.trace(R @ S.T) - 1) / 2
    return float(np.arccos(np.clip(cosine, -1.0, 1.0))), float(np.linalg.norm(t - s))
