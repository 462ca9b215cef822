"""Matching walls by normal, offset and gap along the wall (section II), compiled.

`tracks` are angle (n,), offset (n,), ends (n, 2, 2), sd (n,) and corner_at (n, 2, 2) of tracks;
`seen` are ends (m, 2, 2), along (m, 2), normal (m, 2), size (m,), sd (m,) and static (m, 2) of the
walls of a scan; a `motion` is yaw, x, y.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, solve, unset

Tracks = tuple[Floats, Floats, Floats, Floats, Floats]
Seen = tuple[Floats, Floats, Floats, Floats, Floats, Bools]

SIGMAS = 4.0
"""Tolerance, in standard deviations of the difference between two walls."""
TURN_RAD = np.deg2rad(8.0)
ACROSS_M = 0.12
GAP_M = 0.4
"""Largest deviation of a wall between two scans, independent of the noise: walls are not perfectly
flat, and their ends are not observed exactly."""
WIDEST_TURN_RAD = 0.5
"""Upper limit of the noise contribution to the tolerance of the rotation."""
CLOSE = 0.3
BEYOND = 0.3
"""Reduction of the score of a wall at the edge of a tolerance, relative to exact agreement."""
NEAR_M = 0.5
"""A corner farther off than this, along its wall, does not constrain a motion."""
CORNER = 0.3
"""Weight of a corner, relative to an end of a wall."""
ROUGHLY = 3.0
"""Tolerances of an initial guess, relative to those of the final match."""
HELD = 1e-2
"""Weight of constant motion where the observations do not determine it: a wall has 1."""
LEAST_M = 0.02
"""Lower limit of the noise of a corner when computing its weight."""


@helper
def _cheapest_path(
    worth: Floats,
    start: int,
    column_of: Ints,
    price_column: Floats,
    price_row: Floats,
    work: tuple[Floats, Ints, Bools],
) -> int:
    """Find the shortest path from a column to a free row, and update the prices (Dijkstra).

    `work` are a distance, the predecessor on the path, and whether it is known, of each row.
    Returns the free row.
    """
    n, rows = len(worth), len(price_row)
    least, before, done = work
    for r in range(rows):
        least[r], before[r], done[r] = np.inf, -1, False
    column, last = start, -1
    while column >= 0:
        best, row = np.inf, -1
        for r in range(rows):
            if not done[r]:
                cost = -worth[r, column] if r < n else 0.0
                reach = cost - price_column[column] - price_row[r]
                if reach < least[r]:
                    least[r], before[r] = reach, last
                if least[r] < best:
                    best, row = least[r], r
        price_column[start] += best
        for r in range(rows):
            if done[r]:
                price_column[column_of[r]] += best
                price_row[r] -= best
            else:
                least[r] -= best
        done[row], last, column = True, row, column_of[row]
    return last


@helper
def assigned(worth: Floats) -> Ints:
    """Return the row of each column for a one-to-one assignment of maximum total score (n, m).

    -1 if a column has none, or one with score 0. Shortest augmenting paths (Jonker and Volgenant,
    1987), padded with rows of score 0 if there are more columns.
    """
    n, m = worth.shape
    rows = max(n, m)
    column_of, price_column, price_row = unset(rows), np.zeros(m), np.zeros(rows)
    before = unset(rows)
    work = np.empty(rows), before, np.zeros(rows, dtype=np.bool_)
    for start in range(m):
        last = _cheapest_path(worth, start, column_of, price_column, price_row, work)
        while last >= 0:
            row, last = last, before[last]
            column_of[row] = column_of[last] if last >= 0 else start
    row_of = unset(m)
    for r in range(n):
        if column_of[r] >= 0 and worth[r, column_of[r]] > 0:
            row_of[column_of[r]] = r
    return row_of


@compiled
def carried(tracks: Tracks, motion: Floats) -> Tracks:
    """Return the tracks in another frame, where ``p`` is ``R(yaw) @ p + t``."""
    angle, offset, ends, sd, corner_at = tracks
    c, s, x, y = math.cos(motion[0]), math.sin(motion[0]), motion[1], motion[2]
    n = len(angle)
    new_angle, new_offset = np.empty(n), np.empty(n)
    new_ends, new_corner = np.empty((n, 2, 2)), np.empty((n, 2, 2))
    for i in range(n):
        new_angle[i] = angle[i] + motion[0]
        new_offset[i] = offset[i] + math.cos(new_angle[i]) * x + math.sin(new_angle[i]) * y
        for e in range(2):
            a, b = ends[i, e, 0], ends[i, e, 1]
            new_ends[i, e, 0], new_ends[i, e, 1] = c * a - s * b + x, s * a + c * b + y
            a, b = corner_at[i, e, 0], corner_at[i, e, 1]
            new_corner[i, e, 0], new_corner[i, e, 1] = c * a - s * b + x, s * a + c * b + y
    return new_angle, new_offset, new_ends, sd, new_corner


@helper
def half_turn(angle: float) -> float:
    """Return an angle wrapped to half a turn around 0."""
    turned = angle + math.pi
    near = turned  # the remainder is slow, and the same within a turn
    if near < 0:
        near += 2 * math.pi
    elif near >= 2 * math.pi:
        near -= 2 * math.pi
    return (near if 0 <= near < 2 * math.pi else turned % (2 * math.pi)) - math.pi


@helper
def _lines(seen: Seen) -> Floats:
    """Return the bearing of the normal, the middle (x, y) and both ends along each wall; (m, 5)."""
    ends, along, normal, _, _, _ = seen
    lines = np.empty((len(along), 5))
    for j in range(len(along)):
        ux, uy = along[j, 0], along[j, 1]
        lines[j, 0] = math.atan2(normal[j, 1], normal[j, 0])
        lines[j, 1] = 0.5 * (ends[j, 0, 0] + ends[j, 1, 0])
        lines[j, 2] = 0.5 * (ends[j, 0, 1] + ends[j, 1, 1])
        lines[j, 3] = ux * ends[j, 0, 0] + uy * ends[j, 0, 1]
        lines[j, 4] = ux * ends[j, 1, 0] + uy * ends[j, 1, 1]
    return lines


@helper
def agreement(tracks: Tracks, seen: Seen, wall: Floats, widened: float) -> Floats:
    """Return the score of each track with each wall, (n, m); 0 for no match. `wall`: `_lines`."""
    angle, offset, ends, sd, corner_at = tracks
    _, along, _, size, wall_sd, static = seen
    n, m = len(angle), len(size)
    found, gap_gate = np.zeros((n, m)), GAP_M * widened
    for i in range(n):
        nx, ny = math.cos(angle[i]), math.sin(angle[i])
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        for j in range(m):
            turn = half_turn(wall[j, 0] - angle[i])
            if abs(turn) >= TURN_RAD * widened + WIDEST_TURN_RAD:
                continue
            ux, uy, right, left = along[j, 0], along[j, 1], wall[j, 3], wall[j, 4]
            gap = max(
                right - (ux * ends[i, 1, 0] + uy * ends[i, 1, 1]),
                ux * ends[i, 0, 0] + uy * ends[i, 0, 1] - left,
            )
            if gap >= gap_gate:
                continue
            across = nx * wall[j, 1] + ny * wall[j, 2] - offset[i]
            if abs(across) >= ACROSS_M * widened + SIGMAS * (sd[i] + wall_sd[j]):
                continue  # most walls that are parallel, without a root and a quotient
            spread = math.hypot(sd[i], wall_sd[j])
            blunt = SIGMAS * math.sqrt(12.0) * spread / min(own, size[j])
            turn_gate = TURN_RAD * widened + min(blunt, WIDEST_TURN_RAD)
            across_gate = ACROSS_M * widened + SIGMAS * spread
            if abs(turn) >= turn_gate or abs(across) >= across_gate:
                continue
            worth = (
                1
                - CLOSE * ((turn / turn_gate) ** 2 + (across / across_gate) ** 2)
                - BEYOND * max(gap / gap_gate, 0.0)
            )
            for e in range(2):
                if static[j, e]:
                    at = left if e else right
                    off = (ux * corner_at[i, e, 0] + uy * corner_at[i, e, 1] - at) / gap_gate
                    if abs(off) < 1:  # NaN where there is no corner
                        worth += 1 - off**2
            found[i, j] = worth
    return found


@helper
def _then(first: Floats, second: Floats) -> Floats:
    """Return the composition of two motions."""
    c, s = math.cos(second[0]), math.sin(second[0])
    x, y = c * first[1] - s * first[2], s * first[1] + c * first[2]
    both = np.empty(3)
    both[0], both[1], both[2] = first[0] + second[0], x + second[1], y + second[2]
    return both


@helper
def _pull(
    A: Floats, b: Floats, nx: float, ny: float, x: float, y: float, off: float, w: float
) -> None:
    """Add to the normal equations: a point (x, y) should move by `off` along (nx, ny)."""
    row = (ny * x - nx * y, nx, ny)
    for i in range(3):
        for j in range(3):
            A[i, j] += w * row[i] * row[j]
        b[i] += w * row[i] * off


@helper
def correction(tracks: Tracks, seen: Seen, track_of: Ints) -> Floats:
    """Return the small motion that aligns tracks to the walls that they match (least squares).

    Both ends of a wall seen lie on the line of its track, and a corner seen again at its place
    along the wall. The line of a short track becomes less certain with the distance from the track.
    """
    angle, offset, ends, sd, corner_at = tracks
    wall_ends, along, _, _, _, static = seen
    A, b = np.zeros((3, 3)), np.zeros(3)
    for j in range(len(track_of)):
        i = track_of[j]
        if i < 0:
            continue
        nx, ny = math.cos(angle[i]), math.sin(angle[i])
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        mid_x, mid_y = (ends[i, 0, 0] + ends[i, 1, 0]) / 2, (ends[i, 0, 1] + ends[i, 1, 1]) / 2
        for e in range(2):
            x, y = wall_ends[j, e, 0], wall_ends[j, e, 1]
            beyond = max(abs(ny * (x - mid_x) - nx * (y - mid_y)) / own - 0.5, 0.0)
            w = 1 / (1 + (1 + 12 * beyond**2) * (sd[i] / LEAST_M) ** 2)
            _pull(A, b, nx, ny, x, y, nx * x + ny * y - offset[i], w)
            if static[j, e]:
                ux, uy = along[j, 0], along[j, 1]
                cx, cy = corner_at[i, e, 0], corner_at[i, e, 1]
                off = ux * (x - cx) + uy * (y - cy)
                if abs(off) < NEAR_M:
                    _pull(A, b, ux, uy, cx, cy, off, CORNER)
    A[1, 1] += HELD
    A[2, 2] += HELD
    for i in range(3):
        A[i, i] += 1e-9
    factorise(A)
    solve(A, b)
    return b


@compiled
def settled(
    tracks: Tracks, seen: Seen, guesses: Floats, rounds: int
) -> tuple[Floats, Ints, Floats]:
    """Fit motions (k, 3) to the walls that match, alternating with matching.

    Returns the motions, the track of each of m walls (k, m), -1 for none, and the total scores.
    """
    found, scores = np.empty((len(guesses), 3)), np.empty(len(guesses))
    every, lines = np.empty((len(guesses), len(seen[1])), dtype=np.int64), _lines(seen)
    for k in range(len(guesses)):
        motion, track_of, scores[k] = _settled(tracks, seen, lines, guesses[k], rounds)
        for i in range(3):
            found[k, i] = motion[i]
        for j in range(len(track_of)):
            every[k, j] = track_of[j]
    return found, every, scores


@helper
def _settled(
    tracks: Tracks, seen: Seen, lines: Floats, guess: Floats, rounds: int
) -> tuple[Floats, Ints, float]:
    motion, widened, left = guess, ROUGHLY, rounds
    while True:
        there = carried(tracks, motion)
        worth = agreement(there, seen, lines, widened if left > 0 else 1.0)
        track_of, score = assigned(worth), 0.0
        for j in range(len(track_of)):
            if track_of[j] >= 0:
                score += worth[track_of[j], j]
        if left == 0 or score == 0:
            return motion, track_of, score
        motion = _then(motion, correction(there, seen, track_of))
        widened, left = max(1.0, widened / 2), left - 1
