"""How the dynamic landmarks of a simulated world move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

REACH_M = 12.0
"""A dynamic landmark stays about this near to the middle of where it moves."""
SPEED_M = (0.1, 0.4)
"""Slowest and fastest motion, metres per iteration."""


def dynamic_offsets(count: int, iterations: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw the motion of dynamic landmarks, every kind in equal shares.

    The kinds are constant velocity (turning back at the end of the reach), random walk, circling,
    and stop-and-go; the paper calls a landmark dynamic when its movement has nothing to do with
    the robot's (section I).

    Returns
    -------
    (iterations, count, 3) float64
        Offset of each landmark from the middle of its motion, metres.
    """
    speed = rng.uniform(*SPEED_M, count)
    heading = rng.uniform(0, 2 * np.pi, count)
    phase = rng.uniform(0, 4 * REACH_M, count)
    along = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    travelled = np.arange(iterations)[:, None] * speed + phase
    offsets = np.empty((iterations, count, 3))
    kind = np.arange(count) % 4
    offsets[:, kind == 0] = _to_and_fro(travelled, along)[:, kind == 0]
    offsets[:, kind == 1] = _random_walk(speed, iterations, rng)[:, kind == 1]
    offsets[:, kind == 2] = _circle(travelled, rng.uniform(3.0, 8.0, count))[:, kind == 2]
    offsets[:, kind == 3] = _stop_and_go(speed, along, phase, iterations, rng)[:, kind == 3]
    return offsets


def _to_and_fro(travelled: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fold the distance travelled (k, n) into the reach, along a line (n, 3)."""
    folded = np.abs(travelled % (4 * REACH_M) - 2 * REACH_M) - REACH_M
    return np.asarray(folded[:, :, None] * along)


def _random_walk(
    speed: NDArray[np.float64], iterations: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    steps = rng.normal(0, 1, (iterations, len(speed), 3)) * speed[:, None]
    walk = np.cumsum(steps, axis=0)
    return np.abs((walk + REACH_M) % (4 * REACH_M) - 2 * REACH_M) - REACH_M


def _circle(travelled: NDArray[np.float64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = travelled / radius
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    return np.asarray(flat * radius[:, None])


def _stop_and_go(
    speed: NDArray[np.float64],
    along: NDArray[np.float64],
    phase: NDArray[np.float64],
    iterations: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Go for a while, stand for a while, in turn; both last 10 to 40 iterations."""
    period = rng.uniform(20, 80, len(speed))
    start = rng.uniform(0, 1, len(speed))
    going = (np.arange(iterations)[:, None] / period + start) % 1 < 0.5
    return _to_and_fro(np.cumsum(going * 2 * speed, axis=0) + phase, along)
