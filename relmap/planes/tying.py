"""Submaps that follow one another are tied where all pairs of their scans agree how they lie.

What a single pair of scans could not tell, others near the break may: the search is that of
`relmap.planes.search`, from each of the last scans of one submap to each of the first of the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from relmap.planes.beams import Beams, BeamStore
from relmap.planes.observation import PlaneObservation
from relmap.planes.placement import STILL
from relmap.planes.search import Search, View, after, inverse, others
from relmap.planes.tracks import PlaneTracks

NEAR = 4
"""Iterations that two scans lie apart at most that are compared."""
OPEN = 3
"""Submaps of late that the next one may be tied to."""
VOTES = 2
"""Pairs of scans that must agree, and none may contradict."""
TOGETHER = 7.0
"""Log odds that they must have in sum: they are not independent."""


@dataclass(eq=False)
class Scans:
    """All scans with their walls and beams, and the motions between them.

    Attributes
    ----------
    walls : PlaneObservation
        All that was seen, scan after scan, without beams.
    plane : (n,) int64
        Number of each wall, as when it was seen.
    first_row : (i + 1,) int64
        First row of each scan, and where the last one ends.
    beams : BeamStore
    motions : (i, 3) float64
        From the frame of the scan before into that of each: yaw, x, y.
    """

    walls: PlaneObservation
    plane: NDArray[np.int64]
    first_row: NDArray[np.int64]
    beams: BeamStore
    motions: NDArray[np.float64]

    def rows(self, scan: int) -> slice:
        """Return the rows of the walls of a scan."""
        return slice(*self.first_row[scan : scan + 2].tolist())

    def seen(self, scan: int) -> PlaneObservation:
        """Return the walls of one scan."""
        return self.walls.only(self.rows(scan))

    def beams_of(self, scan: int) -> Beams:
        """Return the beams of one scan."""
        return self.beams.of(scan, self.walls.ends[self.rows(scan)])

    def way(self, first: int, last: int) -> NDArray[np.float64]:
        """Return the motion (3,) from the frame of one scan into that of a later one."""
        motion = np.zeros(3)
        for scan in range(first + 1, last + 1):
            motion = after(motion, self.motions[scan][None])[0]
        return motion


@dataclass(eq=False)
class Tie:
    """How the first scan of a submap lies to the last one of another.

    Attributes
    ----------
    motion : (3,) float64
    pairs : list of (int, int)
        Scans that tell it.
    evidence : float
        The sum of what each pair says: log odds.
    walls : list of (k, 2) int64
        Numbers of walls that are one wall each.
    """

    motion: NDArray[np.float64]
    pairs: list[tuple[int, int]] = field(default_factory=list)
    evidence: float = 0.0
    walls: list[NDArray[np.int64]] = field(default_factory=list)


def tied(scans: Scans, submap: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Tie submaps that follow one another.

    Parameters
    ----------
    scans : Scans
        Its motions are changed where a submap goes on with another.
    submap : (i,) int64
        Of each iteration; -1 where nothing ties it to any.

    Returns
    -------
    submap : (i,) int64
        The same, where those that are tied have the number of the first.
    walls : (k, 2) int64
        Numbers of walls that are one wall each.
    """
    found, recent, walls = submap.copy(), list[NDArray[np.int64]](), [np.empty((0, 2), np.int64)]
    edges = np.flatnonzero(np.diff(submap, prepend=-1, append=-1))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if submap[begin] < 0:
            continue
        own = np.arange(begin, end)
        for k, before in reversed(list(enumerate(recent))):
            tie = _tie(scans, before, own) if begin - before[-1] < NEAR else None
            if tie is not None:
                last = int(before[-1])
                back = inverse(scans.way(last, begin - 1))
                scans.motions[begin] = after(back, tie.motion[None])[0]
                found[own] = found[last]
                walls += tie.walls
                own = np.concatenate([before, own])
                del recent[k]
                break
        recent = [*recent, own][-OPEN:]
    return found, np.concatenate(walls)


def _tie(scans: Scans, before: NDArray[np.int64], later: NDArray[np.int64]) -> Tie | None:
    """Return how a submap lies to one before, where enough pairs of scans agree."""
    a, b = int(before[-1]), int(later[0])
    pairs = product(before[-NEAR:].tolist(), later[:NEAR].tolist())
    tie = None
    for i, j in sorted(pairs, key=lambda pair: (pair[1] - pair[0], pair[1])):
        matched = _matched(scans, i, j, before) if j - i <= NEAR else None
        if matched is None:
            continue
        motion, walls, evidence = matched
        into_last, from_first = inverse(scans.way(i, a)), inverse(scans.way(b, j))
        at_ends = after(after(into_last, motion[None])[0], from_first[None])[0]
        tie = tie or Tie(at_ends)
        if others(at_ends[None], tie.motion)[0]:
            return None
        tie.pairs.append((i, j))
        tie.walls.append(walls)
        tie.evidence += evidence
    if tie is None or len(tie.pairs) < VOTES or tie.evidence < TOGETHER:
        return None
    return tie


def _matched(
    scans: Scans, i: int, j: int, before: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], float] | None:
    """Return the motion from one scan into another, which of their walls are one, and how sure."""
    earlier, later = scans.seen(i), scans.seen(j)
    beams = scans.beams_of(j)
    if not len(earlier) or not len(later) or not len(beams):
        return None
    views = [View(scans.beams_of(i), np.zeros(3))]
    if i - 1 in before[-NEAR - 1 :]:
        views.append(View(scans.beams_of(i - 1), scans.motions[i]))
    tracks = PlaneTracks.begun(scans.plane[scans.rows(i)], earlier)
    tracks.corner_at = np.where(earlier.static[..., None], earlier.ends, np.nan)
    found = Search(tracks, later, beams, views, STILL).found()
    if found is None or not found.measured:
        return None
    rows = found.match.tracks, found.match.walls
    planes = np.column_stack([tracks.plane[rows[0]], scans.plane[scans.rows(j)][rows[1]]])
    return np.array([found.motion.yaw, *found.motion.t]), planes, found.evidence
