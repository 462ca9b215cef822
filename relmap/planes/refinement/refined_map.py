"""The refined map: solving, closing loops and joining walls, alternately.

Identical walls are recognised only in an accurate map, and the map is accurate only after identical
walls were joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.refinement.closing import walls_seen_again
from relmap.planes.refinement.solving import LAST, refined, refined_to_the_noise
from relmap.planes.submaps.submap import (
    WallSubmap,
    among_all,
    disagreement,
    stitched,
    torn_in,
    with_strays_put_back,
)
from relmap.planes.walls.assembly import (
    FLAT_M,
    OFTEN,
    Assembled,
    WallNumbers,
    assemble,
    directions,
    laid_out,
)
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import join_pairs, join_walls, placed_ends

WIDELY = ((2, 1e4), (1, 300.0), (1, 50.0), (1, 15.0), (2, 5.0))
"""Rounds of solutions for closing loops, for any amount of drift."""
CLOSELY = ((5, 1e4), (2, 300.0), (1, 100.0), (1, 20.0), (1, 5.0))
"""The same once a loop is closed."""
BENT = 1.25
"""Factor by which closing a loop may increase the error at links that walls determine: at most 1.04
for right loops in ten logs of lasers and eight simulated corridors, and 1.7 where doors, or parts
of a curve, were confused."""
ROUGHLY = ((1, 8.0), (1, 5.0))
"""Rounds of solutions for joining walls; see `relmap.planes.refinement.solving.refined`."""
WORSE, WORSE_M, WORSE_SHARE, WORSE_SD = 2.0, 0.001, 0.1, 30.0
"""Largest error of a refined map at the links, relative to the chained map, and absolute: in
metres, or, where it is more, as a fraction of the usual step, but no more than a multiple of the
standard deviation of a wall. Links are approximate with noise, the more the longer they are, and
almost exact without."""
SHARPLY = 1.1
"""The first of these for a map at the accuracy of the observations: at most 1.11 for eight logs of
lasers, which it makes up to 13 % better, and 1.14 to 1.8 in simulated corridors that it bends."""
ROUGH_M = 0.1
"""The same with odometry, where links may be the only initial information."""
HELD = 0.0, 1e-4, 1e-3
"""Damping of each step for maps that are torn with less; see `WallSystem`."""
HELD_M = 100.0
"""Longest path of a map that is damped: it stays near the chained one, whose error grows with the
path."""
LONGER = 4
"""Maximum number of last solutions, until one settles: long paths that few walls cross take two."""
JOINED, RESTING_M = 4, 0.1
"""Maximum number of rounds of joining coinciding walls and refining, and the movement of the map
below which a round is the last."""

PIECE_M = 20.0
"""Length of the pieces of a wall."""
UNEVEN, UNEVEN_M = 5.0, 0.05
"""Deviation of observations from a wall above which it is not straight: in standard deviations, and
at least."""


def refined_map(
    history: PlaneHistory, numbers: WallNumbers, chained: WallSubmap, moving: Bools
) -> tuple[WallSubmap, WallNumbers]:
    """Move walls, corners and poses of a submap to the joint optimum of all observations.

    Walls that then coincide are joined, which closes loops. The noise is at least that of real
    walls, see `at_the_noise`.

    `numbers`: initial association; `chained`: initial submap; `moving` (p,): plane tracks ignored
    because they move. Returns `submap`: not refined if nothing is mapped, or if refinement does not
    converge or makes the map worse.
    """
    if chained.assembled is None:
        return chained, numbers
    torn = list[Ints]()
    for held in _dampings(chained):
        found, found_numbers = _solved(history, numbers, chained, moving, held)
        if _better(found, chained, history):
            return found, found_numbers
        torn.append(torn_in([found], history))
    return replace(chained, torn=torn[0]), numbers


def straightened(
    history: PlaneHistory, numbers: WallNumbers, found: WallSubmap, moving: Bools
) -> WallSubmap | None:
    """Return a refined map solved again, with the links where it was bent as equations.

    `history`: with these links in `bent`; `numbers`: the association of the map, which is kept; the
    other arguments are those of `refined_map`. None if it does not converge or gets worse.
    """
    span = found.span
    laid = assemble(history, numbers, among_all(found.poses, span, history), moving)
    if laid is None:
        return None
    again = _refined(refined(laid, (*CLOSELY, LAST), HELD[0]), span, history)
    return again if _better(again, found, history) else None


def at_the_noise(found: WallSubmap, history: PlaneHistory) -> WallSubmap:
    """Return a refined map solved at the accuracy of the observations, unless that is worse.

    Or if it bends: then ends of walls, seen from afar, outweigh the links. Where it is torn, it
    shows that something is wrong.
    """
    assert found.assembled is not None
    motions = history.motion[slice(*found.span)]
    most_m = SHARPLY * disagreement(found.poses, motions)[1] + WORSE_M
    for held in _dampings(found):
        best = refined_to_the_noise(found.assembled, held)
        if best is found.assembled:
            break
        again = _refined(best, found.span, history)
        is_bent = disagreement(again.poses, motions)[1] > most_m
        if _better(again, found, history) and (len(torn_in([again], history)) or not is_bent):
            return again
    return found


def _dampings(submap: WallSubmap) -> Sequence[float]:
    """Return the damping of a map, and of further attempts."""
    return HELD if submap.length_m() < HELD_M else HELD[:1]


def _refined(best: Assembled, span: tuple[int, int], history: PlaneHistory) -> WallSubmap:
    return WallSubmap.of(span, poses_of(best, span, history), best, refined=True)


def _solved(
    history: PlaneHistory, numbers: WallNumbers, chained: WallSubmap, moving: Bools, held: float
) -> tuple[WallSubmap, WallNumbers]:
    """Return the refined submap and its association."""
    assert chained.assembled is not None
    span, motions = chained.span, history.motion[slice(*chained.span)]
    measured = np.where(np.isin(np.arange(*span), history.weak_links)[:, None], np.nan, motions)

    def again(joined: WallNumbers, rounds: Sequence[tuple[int, float]]) -> tuple[Assembled, Floats]:
        """Return the map and its poses after a change of the association."""
        laid = assemble(history, joined, among_all(poses, span, history), moving)
        found = best if laid is None else refined(laid, rounds, held)
        return found, poses_of(found, span, history)

    best = refined(chained.assembled, WIDELY, held)
    poses = poses_of(best, span, history)
    torn = max(disagreement(path, motions)[0] for path in (chained.poses, poses))
    joined = join_pairs(best, numbers, walls_seen_again(best, history))
    if not joined.same_as(numbers):
        tied = again(joined, CLOSELY)
        off_m, off_before_m = (disagreement(path, measured)[1] for path in (tied[1], poses))
        bent = off_m > BENT * off_before_m + WORSE_M
        # Otherwise similar places were confused.
        if not bent and disagreement(tied[1], motions)[0] <= torn:
            numbers, (best, poses) = joined, tied
    for _ in range(JOINED):
        joined = join_walls(best, numbers)
        if joined.same_as(numbers):
            break
        before = poses
        numbers, (best, poses) = joined, again(joined, ROUGHLY)
        if np.nanmax(np.hypot(*(poses - before)[:, :2, 3].T)) < RESTING_M:
            break
    return _refined(_last(best, held, history), span, history), numbers


def _last(best: Assembled, held: float, history: PlaneHistory) -> Assembled:
    """Return the last solution, its path from pieces of walls that are not straight."""
    best = _settled(best, held)
    pieces = in_pieces(best, history)
    if pieces is None:
        return best
    found = _settled(refined(pieces, ROUGHLY, held), held)
    path = found.poses(history.n_iterations)[best.iterations]
    return replace(best, state=laid_out(best.given, path), settled=found.settled)


def in_pieces(assembled: Assembled, history: PlaneHistory) -> Assembled | None:
    """Return the equations with long uneven walls in pieces, each a wall with its own corners.

    As one line, several that are nearly in line and were joined would bend the path. The standard
    deviations of observations are those of pieces, as they were first. Returns None if there is no
    such wall.
    """
    given, state = assembled.given, assembled.state
    sd = np.hypot(history.sd[assembled.rows], FLAT_M)
    along = directions(state.angle)[1][given.wall]
    middle = placed_ends(assembled).mean(axis=1) - state.centre[given.wall]
    piece = np.rint((middle * along).sum(axis=1) / PIECE_M).astype(np.int64)
    piece[given.sd < np.maximum(UNEVEN * sd, UNEVEN_M)] = 0
    wall = _numbered(given.wall, piece)
    piece[np.bincount(wall)[wall] < OFTEN] = 0
    wall = _numbered(given.wall, piece)
    if wall.max() == given.wall.max():
        return None
    corner = _numbered(given.corner, wall[given.corner_row])
    divided = replace(given, wall=wall, corner=corner, sd=sd)
    poses = assembled.poses(history.n_iterations)[assembled.iterations]
    return replace(assembled, given=divided, state=laid_out(divided, poses))


def _numbered(one: Ints, other: Ints) -> Ints:
    """Return the number of each pair (n,) of numbers, from 0."""
    pairs = np.column_stack([one, other])
    return np.unique(pairs, axis=0, return_inverse=True)[1].ravel()


def _settled(best: Assembled, held: float) -> Assembled:
    """Return the solution after as many rounds as it takes to converge."""
    for _ in range(LONGER):
        best = refined(best, (LAST,), held)
        if best.settled:
            break
    return best


def _better(found: WallSubmap, chained: WallSubmap, history: PlaneHistory) -> bool:
    """Return whether a refined map converged and agrees with the links between its scans."""
    assert found.assembled is not None
    motions = history.motion[slice(*found.span)]
    torn, off_m = disagreement(found.poses, motions)
    torn_before, off_before_m = disagreement(chained.poses, motions)
    step_m = float(np.median(np.hypot(*history.motion[:, 1:].T)))
    rough_m = min(WORSE_SHARE * step_m, WORSE_SD * float(np.median(history.sd)))
    worse_m = ROUGH_M if history.odometry else max(WORSE_M, rough_m)
    agrees = torn <= torn_before and off_m <= WORSE * off_before_m + worse_m
    return found.assembled.settled and agrees


def poses_of(assembled: Assembled, span: tuple[int, int], history: PlaneHistory) -> Floats:
    """Return the poses (k, 4, 4) of a submap by its refined map, else by the motion since."""
    rows = slice(*span)
    poses, motion = assembled.poses(history.n_iterations)[rows], history.motion[rows]
    own = history.own(span)[:, None, None]
    whole = with_strays_put_back(stitched([poses], motion), motion)
    return np.where(own, whole, np.nan)
