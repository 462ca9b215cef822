"""The paper's recipe: pairs of walls, and a chain of the strongest relations (section II).

For each pair of walls, both are rotated so that the first is at 0 degrees, and their differences in
position and orientation are averaged over their common interval (Figs 1 and 2). The static corners
are found by the four pairs of midpoints, estimated from either end of either wall and a size that
is fixed over the interval: the pair with the lowest standard deviation is chosen (Fig. 4).

`PlaneMapper` does the same with all walls of a group at once, with end types as a prior and the
deviation as a check; this module serves as a baseline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.motions import inverse, then, wrapped
from relmap.planes.scans.corners import deviations, midpoint_pairs
from relmap.planes.walls.history import PlaneHistory

FEWEST = 3
"""Minimum number of common iterations to compute a deviation."""


@dataclass(frozen=True, eq=False)
class Relation:
    """Relative location of two walls.

    `offset` (2,), metres: from midpoint to midpoint, the first wall's normal along x; `turn`:
    radians; `deviation`, metres: standard deviation of the offset, for the chosen pair of ends;
    `ends` (2,) int: static end of the first wall and of the second: 0 right, 1 left; `n`: number of
    common iterations.
    """

    offset: Floats
    turn: float
    deviation: float
    ends: tuple[int, int]
    n: int


def relate(first: Floats, second: Floats, sizes: tuple[float, float]) -> Relation:
    """Average the relation of two walls over their common interval.

    `first`, `second` (k, 2, 2), robot frame, metres: right and left ends of both walls; `sizes`:
    one size for each wall.
    """
    offset = midpoint_pairs(first, second, *sizes)
    deviation = deviations(offset)
    i, j = np.unravel_index(np.argmin(deviation), deviation.shape)
    (x, y), (other_x, other_y) = ((ends[:, 1] - ends[:, 0]).T for ends in (first, second))
    turn = wrapped(np.arctan2(other_y, other_x) - np.arctan2(y, x))
    steady = float(turn[0] + wrapped(turn - turn[0]).mean())
    mean = offset.mean(axis=0)[i, j]
    return Relation(mean, steady, float(deviation[i, j]), (int(i), int(j)), len(first))


def pairwise_map(history: PlaneHistory, n_planes: int) -> Floats:
    """Return the ends of all walls by the chain of the strongest pairwise relations.

    The relations with the least deviation, divided by the square root of the common interval, form
    a spanning tree; the frame is that of its first wall, whose normal is along x.

    Returns (n_planes, 2, 2), metres: NaN for walls not connected to the first.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    rows_of = [np.flatnonzero(history.plane == plane) for plane in range(n_planes)]
    seen_m = np.linalg.norm(history.ends[:, 1] - history.ends[:, 0], axis=1)
    size = np.array([seen_m[rows].max(initial=0.0) for rows in rows_of])
    relations: dict[tuple[int, int], Relation] = {}
    for a in range(n_planes):
        for b in range(a + 1, n_planes):
            _, i, j = np.intersect1d(
                history.iteration[rows_of[a]], history.iteration[rows_of[b]], return_indices=True
            )
            if len(i) >= FEWEST:
                first, second = history.ends[rows_of[a][i]], history.ends[rows_of[b][j]]
                relations[a, b] = relate(first, second, (size[a], size[b]))
    if not relations:
        return np.full((n_planes, 2, 2), np.nan)
    pairs = np.array(list(relations), dtype=np.int32)  # which csgraph of scipy 1.15 needs
    doubt = np.array([1e-12 + r.deviation / np.sqrt(r.n) for r in relations.values()])
    graph = coo_array((doubt, (pairs[:, 0], pairs[:, 1])), shape=(n_planes, n_planes))
    tree = minimum_spanning_tree(graph.tocsr())
    root = int(pairs[0, 0])
    order, before = breadth_first_order(tree, root, directed=False)
    return _chained(relations, order.astype(np.int64), before.astype(np.int64), size)


def _chained(
    relations: dict[tuple[int, int], Relation], order: Ints, before: Ints, size: Floats
) -> Floats:
    pose = np.full((len(size), 3), np.nan)  # of the walls: angle and midpoint
    pose[order[0]] = 0.0
    for b in order[1:].tolist():
        a = int(before[b])
        relation = relations.get((a, b)) or relations[b, a]
        step = np.array([relation.turn, *relation.offset])
        pose[b] = then(step if (a, b) in relations else inverse(step), pose[a])
    along = np.column_stack([np.sin(pose[:, 0]), -np.cos(pose[:, 0])])
    half = size[:, None] / 2 * along
    return np.stack([pose[:, 1:] - half, pose[:, 1:] + half], axis=1)
