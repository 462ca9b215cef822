"""Elements of floor plans: walls with doors, rooms, panels, paths around them.

A wall is the segment (x0, y0) to (x1, y1) from z0 to z1. Its front is to the left of the direction
from the first end to the second, so that its ends go from right to left as seen from the front. A
thin wall between two rooms is two walls, one for each side.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from relmap.core.arrays import Floats, Ints

TURN_RADIUS_M = 1.8
"""Radius at which the robot rounds corners in the middle of the corridor."""
PANEL_M = (0.8, 2.0)
CLEARANCE_M = 0.6
"""Minimum distance of a panel from other walls, and of the robot from all walls."""
TRIALS = 30
"""Maximum number of attempts to place a panel."""
BOX_M, BOX_GAP_M, BOX_TRIALS = (0.3, 1.2), 0.15, 10
"""Sides of a piece of furniture, its minimum distance from walls, and attempts to place it."""
NOTHING: Floats = np.empty((0, 4))


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Walls, the area for the robot, and the closed line it drives.

    `walls` (w, 6), map frame, metres: x0, y0, x1, y1, z0, z1; they touch but do not cross, and all
    have the same z0 and z1. (w, 4) before the heights are drawn. `floors` (f, 4), metres:
    rectangles x_low, y_low, x_high, y_high without fixed walls inside; none if walls are oblique or
    curved. `loop` (l, 2), metres: the line, counter-clockwise; from the last point it goes back to
    the first. `doors` (d, 2, 2), metres: both jambs of each door; the room is to the left of the
    way from the first to the second. `glass` (g,): which walls are of glass.
    """

    walls: Floats
    floors: Floats
    loop: Floats
    doors: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    glass: Ints = field(default_factory=lambda: np.empty(0, np.int64))


def wall_distances(points: Floats, walls: Floats) -> Floats:
    """Return the distances (n, w) of points (n, 2) from walls (w, 4 or more), metres."""
    first, along = walls[:, :2], walls[:, 2:4] - walls[:, :2]
    offset = points[:, None] - first
    t = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - t[..., None] * along, axis=2))


def edges(box: Floats) -> Floats:
    """Return the sides (4, 2, 2) of a rectangle, counter-clockwise: below, right, above, left."""
    corners = box[np.array([[0, 1], [2, 1], [2, 3], [0, 3]])]
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def cut(edge: Floats, doors: Floats) -> Floats:
    """Return the parts of a wall (2, 2) between doors (d, 2, 2), as rows x0, y0, x1, y1."""
    along = edge[1] - edge[0]
    offset = doors - edge[0]
    t = offset @ along / (along @ along)
    away = np.abs(offset[..., 0] * along[1] - offset[..., 1] * along[0])
    here = ((away < 1e-9) & (t > 0) & (t < 1)).all(axis=1)
    gaps = doors[here].reshape(-1, 2)[np.argsort(t[here], axis=None)]
    return np.vstack([edge[:1], gaps, edge[1:]]).reshape(-1, 4)


def panels(
    box: Floats, count: int, rng: np.random.Generator, obstacles: Floats = NOTHING
) -> Floats:
    """Place panels in a rectangle, clear of its sides, of each other and of obstacles (o, 4).

    Returns (2 p, 4): both sides of each; fewer than `count` if they do not fit.
    """
    low, high = box[:2] + CLEARANCE_M, box[2:] - CLEARANCE_M
    tries = count * TRIALS
    middle = rng.uniform(low, high, (tries, 2))
    yaw, length = rng.uniform(0, np.pi, tries), rng.uniform(*PANEL_M, tries)
    half = length[:, None] / 2 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    inside = ((np.abs(half) < middle - low) & (np.abs(half) < high - middle)).all(axis=1)
    placed = [NOTHING]
    for k in np.flatnonzero(inside):
        if len(placed) > count:
            break
        points = middle[k] + np.linspace(-1, 1, 21)[:, None] * half[k]
        if (wall_distances(points, np.vstack([obstacles, *placed])) > CLEARANCE_M).all():
            right, left = middle[k] - half[k], middle[k] + half[k]
            placed.append(np.array([[*right, *left], [*left, *right]]))
    return np.vstack(placed)


def ring(hall: Floats, block: Floats) -> Floats:
    """Return the four rectangles (4, 4) between two rectangles."""
    (x0, y0, x1, y1), (a0, b0, a1, b1) = hall, block
    return np.array([[x0, y0, x1, b0], [x0, b1, x1, y1], [x0, b0, a0, b1], [a1, b0, x1, b1]])


def rounded(box: Floats) -> Floats:
    """Return a rectangle with rounded corners as a dense line, counter-clockwise."""
    quarter = np.linspace(-np.pi / 2, 0, 60)
    arcs = []
    for k, corner in enumerate(edges(box)[:, 1]):
        angle = quarter + k * np.pi / 2
        inward = np.sign((box[:2] + box[2:]) / 2 - corner)
        middle = corner + TURN_RADIUS_M * inward
        arcs.append(middle + TURN_RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.vstack(arcs)


def boxes(plan: FloorPlan, floor: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Place boxes on a floor, clear of walls and of the robot's path.

    Returns (4 b, 4): their sides, fronts outwards; fewer than `count` if they do not fit.
    """
    placed, way = [NOTHING], np.hstack([plan.loop, np.roll(plan.loop, -1, axis=0)])
    share = np.linspace(0, 1, 9)[:, None]
    for _ in range(count * BOX_TRIALS):
        half = rng.uniform(*BOX_M, 2) / 2
        yaw = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
        c, s = np.cos(yaw), np.sin(yaw)
        around = edges(np.concatenate([-half, half])) @ np.array([[c, s], [-s, c]])
        sides = (around + rng.uniform(floor[:2], floor[2:]))[:, ::-1]
        points = ((1 - share) * sides[:, :1] + share * sides[:, 1:]).reshape(-1, 2)
        others = np.vstack([plan.walls[:, :4], plan.doors.reshape(-1, 4), *placed])
        clear = wall_distances(points, way).min() > CLEARANCE_M
        if clear and wall_distances(points, others).min() > BOX_GAP_M:
            placed.append(sides.reshape(-1, 4))
        if len(placed) > count:
            break
    return np.vstack(placed)
