"""Loop closure under drift: two scans of one place, far apart in time, are matched.

This uses the registration of `placement` between a scan and an earlier one taken nearby according
to the map. Since single scans may be ambiguous, each scan of the later visit has one vote, however
many earlier ones it matches, and several votes must agree. Only the identity of the matched walls
is used, not the motion.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.planes.linking.placement import PlaneTracks, place, worth
from relmap.planes.motions import wrapped
from relmap.planes.scans.observation import PlaneObservation
from relmap.planes.walls.assembly import Assembled
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import seen_in

COMPARED = 400
"""Approximate number of scans, evenly spaced, compared with earlier ones."""
LONG_AGO_M = 15.0
"""Distance travelled after which a place counts as revisited."""
VISIT_M = 5.0
VISITS = 4
"""Distance per compared scan, and number of visits."""
NEAR_M = 4.0
TURNED_RAD = np.deg2rad(50.0)
"""Largest distance between two compared scans, according to the map."""
ENOUGH = 3
"""Minimum number of matching walls."""
SHARE = 0.5
"""Fraction of the walls and corners of the poorer scan that must match."""
VOTES = 3
"""Scans of the later visit that must agree on the drift since the earlier one."""
LATER_M, EARLIER_M = 7.0, 14.0
"""Largest distance travelled between scans of one visit, for the later and the earlier visit."""
DRIFT_M = 0.2
DRIFT_RAD = np.deg2rad(4.0)
"""Largest difference between agreeing drifts."""

CLOSED = np.zeros(3), np.empty((0, 2), dtype=np.int64)
"""The result for two scans that already share walls: no drift, and no walls to join."""

Loop = tuple[float, float, Floats, Ints]
"""A later and an earlier scan, by distance travelled in metres; the drift between them; and the
matching walls."""


def walls_seen_again(assembled: Assembled, history: PlaneHistory) -> Ints:
    """Return pairs (k, 2) of compact wall numbers that are one wall, seen on two visits."""
    found: list[Loop] = []
    rows, way_m, pairs = assembled.rows, gone_m(assembled), _earlier(assembled)
    kind = (history.corner[rows] >= 0).astype(np.int8)
    seen = PlaneObservation.of(history.ends[rows], kind, history.sd[rows], history.z_extent[rows])
    walls = seen_in(assembled)
    shared = walls[:, pairs[:, 0]].multiply(walls[:, pairs[:, 1]]).sum(axis=0)
    for (i, j), known in zip(pairs.tolist(), (shared >= ENOUGH).tolist(), strict=True):
        matched = CLOSED if known else _matched(assembled, seen, j, i)
        if matched is not None:
            found.append((float(way_m[i]), float(way_m[j]), *matched))
    return voted(found)


def voted(found: list[Loop]) -> Ints:
    """Return pairs (k, 2) of distinct walls joined by loops with enough votes."""
    joining = [loop for loop in found if len(loop[3])]
    pairs = [pair for loop in joining if votes(loop, found) >= VOTES for pair in loop[3]]
    unique = np.unique(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=0)
    return np.asarray(unique[unique[:, 0] != unique[:, 1]])


def votes(loop: Loop, found: list[Loop]) -> int:
    """Count the scans of the later visit that agree with a loop, including its own."""
    i, j, drift, _ = loop
    agreeing = set[float]()
    for other, earlier, its_drift, _ in found:
        if abs(other - i) <= LATER_M and abs(earlier - j) <= EARLIER_M:
            off = drift - its_drift
            if np.hypot(off[1], off[2]) < DRIFT_M and abs(wrapped(off[:1])[0]) < DRIFT_RAD:
                agreeing.add(other)
    return len(agreeing)


def _earlier(assembled: Assembled) -> Ints:
    """Return pairs of a later and an earlier scan (k, 2) to compare.

    For each of the nearest earlier visits, the scan nearest to the later one according to the map.
    """
    state, iterations, way_m = assembled.state, assembled.iterations, gone_m(assembled)
    later = np.arange(0, len(iterations), 1 + len(iterations) // COMPARED)
    near = cKDTree(state.t[later]).sparse_distance_matrix(
        cKDTree(state.t), NEAR_M, output_type="ndarray"
    )
    i, before = later[near["i"]], near["j"].astype(np.int64)
    turned = np.abs(wrapped(state.yaw[before] - state.yaw[i]))
    cost = near["v"] + turned
    kept = (way_m[i] - way_m[before] > LONG_AGO_M) & (turned < TURNED_RAD)
    pairs, cost = np.column_stack([i, before])[kept], cost[kept]
    # The best scan of each visit, then the best visits of each later scan.
    visit = (way_m[pairs[:, 1]] // VISIT_M).astype(np.int64)
    pairs, cost = _best(pairs, cost, pairs[:, 0] * (1 + iterations[-1]) + visit, 1)
    return _best(pairs, cost, pairs[:, 0], VISITS)[0]


def gone_m(assembled: Assembled) -> Floats:
    """Return the distance travelled up to each scan of a map (i,), metres."""
    steps = np.linalg.norm(np.diff(assembled.state.t, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _best(pairs: Ints, cost: Floats, group: Ints, most: int) -> tuple[Ints, Floats]:
    """Return the pairs (k, 2) of least cost of each group (k,), up to a maximum."""
    order = np.lexsort((pairs[:, 1], cost, group))
    group = group[order]
    order = order[np.arange(len(group)) - np.searchsorted(group, group) < most]
    return pairs[order], cost[order]


def _matched(
    assembled: Assembled, seen: PlaneObservation, j: int, i: int
) -> tuple[Floats, Ints] | None:
    """Match an earlier scan to a later one.

    Returns `drift` (3,): yaw, x, y between the motion found and the map's, in map axes and `walls`
    (k, 2).
    """
    begin, end = np.searchsorted(assembled.given.iteration, [[j, i], [j + 1, i + 1]])
    if (end - begin).min() < ENOUGH:
        return None
    (earlier, earlier_wall), (later, later_wall) = (
        (seen.only(rows), assembled.given.wall[rows]) for rows in map(slice, begin, end)
    )
    state = assembled.state
    c, s = np.cos(state.yaw[i]), np.sin(state.yaw[i])
    x, y = state.t[j] - state.t[i]
    turn = wrapped(state.yaw[[j]] - state.yaw[[i]])[0]
    expected = np.array([turn, c * x + s * y, -s * x + c * y])
    tracks = PlaneTracks.of_scan(np.arange(len(earlier)), earlier)
    found = place(tracks, later, expected)
    if found is None:
        return None
    motion, match = found
    possible = min(worth(tracks, later, np.ones(len(earlier), dtype=np.bool_)))
    if len(match.tracks) < ENOUGH or match.score < SHARE * possible:
        return None
    turn, x, y = motion - expected
    drift = np.array([turn, c * x - s * y, s * x + c * y])
    return drift, np.column_stack([earlier_wall[match.tracks], later_wall[match.walls]])
