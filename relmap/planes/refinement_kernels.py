"""The joint least squares over walls with the poses eliminated; see `relmap.planes.refinement`.

`seen` are iteration (n,), wall (n,), points (n, 2, 2), corner_row (k,), corner_at (k, 2) and corner
(k,): two points of each wall seen and the static corners, robot frame.  `state` are turn (i, 2),
the cosine and sine of each yaw, t (i, 2), centre (w, 2), normal (w, 2), across (w,) and along (c,).
Rows and corners of one iteration are those from `begins[0][i]` and `begins[1][i]` on.  The unknowns
are numbered as they are eliminated; of each wall its angle, and then its distance across.

`stretches` are scans in a row: `last` (g + 1,) where each begins, `begin` (g + 1,) and `unknowns`
those seen in each, ascending; `entry` where the lower triangle of each is in the matrix; `line`
(n,) and `corner` (k,) the number, within the stretch, of each row's angle and each corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.order_kernels import median, smallest
from relmap.core.linalg.small_kernels import inverse3

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Seen = tuple[Index, Index, Array, Index, Array, Index]
State = tuple[Array, Array, Array, Array, Array, Array]
Stretches = tuple[Index, Index, Index, Index, Index, Index]

LOOSE, STIFF = 1e-10, 1e3
"""What holds a pose that hangs by too little, and one where nothing tells of it, as a share of what
holds it otherwise."""
USUAL = 3.0
"""No residual is in doubt that is not larger than so many typical ones, of all or of its scan."""


@compiled
def views(seen: Seen, state: State) -> Array:
    """Return how each row sees its wall (n, 4): its normal, robot frame, and where the robot is.

    That is off the wall's centre, across the wall and along it, metres.
    """
    iteration, wall, _, _, _, _ = seen
    turn, t, centre, normal, _, _ = state
    found = np.empty((len(wall), 4))
    for r in range(len(wall)):
        i, w = iteration[r], wall[r]
        c, s, nx, ny = turn[i, 0], turn[i, 1], normal[w, 0], normal[w, 1]
        x, y = t[i, 0] - centre[w, 0], t[i, 1] - centre[w, 1]
        found[r, 0], found[r, 1] = c * nx + s * ny, c * ny - s * nx
        found[r, 2], found[r, 3] = nx * x + ny * y, ny * x - nx * y
    return found


@compiled
def residuals(seen: Seen, state: State) -> tuple[Array, Array]:
    """Return how far points (n, 2) are from their lines and corners (k,) along theirs, metres."""
    _, wall, points, corner_row, corner_at, corner = seen
    distance, place, view = state[4], state[5], views(seen, state)
    across, along = np.empty((len(wall), 2)), np.empty(len(corner))
    for r in range(len(wall)):
        for p in range(2):
            x, y = points[r, p, 0], points[r, p, 1]
            across[r, p] = view[r, 0] * x + view[r, 1] * y + view[r, 2] - distance[wall[r]]
    for k in range(len(corner)):
        r, x, y = corner_row[k], corner_at[k, 0], corner_at[k, 1]
        along[k] = view[r, 1] * x - view[r, 0] * y + view[r, 3] - place[corner[k]]
    return across, along


@compiled
def observation_weights(
    off: tuple[Array, Array],
    sd: tuple[Array, Array],
    begins: tuple[Index, Index],
    doubtful: float,
    by_scan: bool,
) -> tuple[Array, Array]:
    """Return the weights of points (n, 2) and corners (k,) by Geman and McClure.

    Parameters
    ----------
    off, sd : (n, 2) and (k,), (n,) and (k,)
        Residuals and their standard deviations.
    begins : (i + 1,) and (i + 1,) int64
    doubtful : float
        Residual, in standard deviations, from which one counts less and less.
    by_scan : bool
        Whether that of a scan whose residuals are all large is larger.
    """
    across, along = np.abs(off[0]), np.abs(off[1])
    for r in range(len(across)):
        across[r] /= sd[0][r]
    along /= sd[1]
    usual = median(np.concatenate((across.copy().reshape(-1), along)))
    for i in range(len(begins[0]) - 1):
        scan = across[begins[0][i] : begins[0][i + 1]]
        corners = along[begins[1][i] : begins[1][i + 1]]
        own, typical = np.concatenate((scan.copy().reshape(-1), corners)), usual
        if by_scan and len(own):
            typical = max(usual, smallest(own, (len(own) - 1) // 2))
        limit = max(doubtful, USUAL * typical)
        for r in range(len(scan)):
            for p in range(2):
                scan[r, p] = (1 + (scan[r, p] / limit) ** 2) * sd[0][begins[0][i] + r]
        for k in range(len(corners)):
            corners[k] = (1 + (corners[k] / limit) ** 2) * sd[1][begins[1][i] + k]
    return 1 / across**2, 1 / along**2


@compiled
def _add(
    sums: tuple[Array, Array, Array, Array],
    line: int,
    other: int,
    w: float,
    off: float,
    by: tuple[float, float, float, float],
) -> None:
    """Add a residual of weight w, with its derivatives by a wall's angle and by the pose.

    That by `other`, the distance across or the place along, is -1.
    """
    own, right, coupling, pose = sums
    own[line, line] += w * by[0] * by[0]
    own[max(line, other), min(line, other)] -= w * by[0]
    own[other, other] += w
    right[line] -= w * by[0] * off
    right[other] += w * off
    for p in range(3):
        pull = w * by[p + 1]
        coupling[p, line] += pull * by[0]
        coupling[p, other] -= pull
        pose[3, p] -= pull * off
        for o in range(3):
            pose[p, o] += pull * by[o + 1]


@compiled
def _one_scan(
    seen: Seen,
    state: State,
    view: Array,
    weights: tuple[Array, Array],
    i: int,
    begins: tuple[Index, Index],
    numbers: tuple[Index, Index],
    sums: tuple[Array, Array, Array, Array],
) -> None:
    """Add what one iteration says.

    To the matrix (u, u), its lower triangle, and the right side (u,) of the unknowns of its
    stretch; to their coupling to the pose (3, u), and to the pose's matrix and right side (4, 3).
    """
    _, wall, points, corner_row, corner_at, corner = seen
    (c, s), distance, place = state[0][i], state[4], state[5]
    for r in range(begins[0][i], begins[0][i + 1]):
        line, (a, b, out, beside) = numbers[0][r], view[r]
        for p in range(2):
            x, y = points[r, p, 0], points[r, p, 1]
            arm = b * x - a * y
            off = a * x + b * y + out - distance[wall[r]]
            by = (-arm - beside, arm, c * a - s * b, s * a + c * b)
            _add(sums, line, line + 1, weights[0][r, p], off, by)
    for k in range(begins[1][i], begins[1][i + 1]):
        r, x, y = corner_row[k], corner_at[k, 0], corner_at[k, 1]
        a, b, out, beside = view[r]
        arm = a * x + b * y
        off = b * x - a * y + beside - place[corner[k]]
        by = (arm + out, -arm, s * a + c * b, s * b - c * a)
        _add(sums, numbers[0][r], numbers[1][k], weights[1][k], off, by)


@compiled
def _held(pose: Array, turn: Array, open_along: Array, firmer: float) -> None:
    """Hold a pose where nothing tells of it, and a little where it hangs by too little."""
    (c, s), (x, y), shift = turn, open_along, pose[1, 1] + pose[2, 2]
    way = (0.0, c * x - s * y, s * x + c * y)
    for p in range(3):
        for o in range(3):
            pose[p, o] += STIFF * shift * way[p] * way[o]
        pose[p, p] += LOOSE * firmer * (pose[0, 0] if p == 0 else shift) + 1e-300


@compiled
def _eliminate(
    own: Array, right: Array, coupling: Array, pose: Array, inverse: Array, away: Array
) -> None:
    """Take away what a free pose leaves of its scan; put into `away` (3, u) how nodes move it."""
    for p in range(3):
        for o in range(3):
            for a in range(len(right)):
                away[p, a] += inverse[p, o] * coupling[o, a]
    for a in range(len(right)):
        x, y, z = away[0, a], away[1, a], away[2, a]
        if x == 0 and y == 0 and z == 0:
            continue
        right[a] -= x * pose[3, 0] + y * pose[3, 1] + z * pose[3, 2]
        row, first, second, third = own[a, : a + 1], coupling[0], coupling[1], coupling[2]
        for b in range(len(row)):
            row[b] -= x * first[b] + y * second[b] + z * third[b]


@compiled
def wall_equations(
    seen: Seen,
    state: State,
    weights: tuple[Array, Array],
    begins: tuple[Index, Index],
    open_along: Array,
    stretches: Stretches,
    matrix: Array,
    firmer: float,
) -> tuple[Array, Array, Array]:
    """Add the normal equations of walls and corners to a matrix, poses eliminated.

    The first iteration stays where it is.  `open_along` (i, 2) is the direction, if any, in which
    an iteration saw nothing that tells where it was.  Poses are held `firmer` than by `LOOSE`.

    Returns
    -------
    right (u,)
        Right side.
    away
        By how much a step of each unknown of its stretch moves each pose back, (3, .) after (3, .).
    pose_step (i, 3)
        The steps of the poses if no unknown moved.
    """
    last, begin, unknowns, entry, line, corner = stretches
    total, at, gone = np.zeros(unknowns.max() + 1), 0, 0
    away = np.zeros(3 * ((last[1:] - last[:-1]) * (begin[1:] - begin[:-1])).sum())
    pose_step, view = np.zeros((last[-1], 3)), views(seen, state)
    for g in range(len(begin) - 1):
        u = begin[g + 1] - begin[g]
        own, right = np.zeros((u, u)), np.zeros(u)
        for i in range(last[g], last[g + 1]):
            coupling, pose = np.zeros((3, u)), np.zeros((4, 3))
            sums = own, right, coupling, pose
            _one_scan(seen, state, view, weights, i, begins, (line, corner), sums)
            _held(pose, state[0][i], open_along[i], firmer)
            inverse, positive = inverse3(pose[:3])
            if i > 0 and positive:
                back = away[gone : gone + 3 * u].reshape(3, u)
                _eliminate(own, right, coupling, pose, inverse, back)
                for p in range(3):
                    for o in range(3):
                        pose_step[i, p] += inverse[p, o] * pose[3, o]
            gone += 3 * u
        for a in range(u):
            total[unknowns[begin[g] + a]] += right[a]
            for b in range(a + 1):
                matrix[entry[at]] += own[a, b]
                at += 1
    return total, away, pose_step


@compiled
def pose_steps(stretches: Stretches, away: Array, pose_step: Array, step: Array) -> Array:
    """Return the steps (i, 3) of the poses that belong to a step (u,) of walls and corners."""
    last, begin, unknowns, _, _, _ = stretches
    found, gone = pose_step.copy(), 0
    for g in range(len(begin) - 1):
        own = step[unknowns[begin[g] : begin[g + 1]]]
        for i in range(last[g], last[g + 1]):
            for p in range(3):
                back = away[gone : gone + len(own)]
                gone += len(own)
                for a in range(len(own)):
                    found[i, p] -= back[a] * own[a]
    return found
