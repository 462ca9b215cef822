"""Which segments cross, and which a ray meets, for tests of simulated worlds."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats


def crossings(walls: Floats, others: Floats | None = None) -> int:
    """Count pairs of segments (x0, y0, x1, y1, ...) that meet inside both of them.

    Two sides of one wall do not; with `others`, those of the two kinds that meet are counted.
    """
    count = 0
    others = walls if others is None else others
    a, b = others[:, :2], others[:, 2:4]
    for wall in walls:
        d, e = wall[2:4] - wall[:2], b - a
        det = d[0] * e[:, 1] - d[1] * e[:, 0]
        offset = a - wall[:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (offset[:, 0] * e[:, 1] - offset[:, 1] * e[:, 0]) / det
            u = (offset[:, 0] * d[1] - offset[:, 1] * d[0]) / det
        inside = (t > 1e-9) & (t < 1 - 1e-9) & (u > 1e-9) & (u < 1 - 1e-9)
        count += int((inside & (np.abs(det) > 1e-12)).sum())
    return count


def cast(ends: Floats, bearing: float) -> tuple[float, int]:
    """Return how far a ray goes to the nearest wall, and which it is; walls hide from both sides.

    Of two sides of a wall it names the one that faces the robot.
    """
    (x, y), (a, b) = (np.cos(bearing), np.sin(bearing)), (ends[:, 0], ends[:, 1])
    back = a - b
    det = x * back[:, 1] - y * back[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = (a[:, 0] * back[:, 1] - a[:, 1] * back[:, 0]) / det
        t = (x * a[:, 1] - y * a[:, 0]) / det
    faces = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0
    best, which = np.inf, -1
    met = (np.abs(det) >= 1e-14) & (t >= 0) & (t <= 1) & (distances > 0)
    for number in np.flatnonzero(met).tolist():
        distance = float(distances[number])
        if distance < best - 1e-9 or (distance < best + 1e-9 and faces[number]):
            best, which = distance, number
    return best, which
