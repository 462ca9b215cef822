"""The figure-eight world of sections IV and V: one robot, many point landmarks.

The path is a lemniscate of Gerono that climbs during its first half and descends during its
second (Fig. 13), so the robot crosses its own path at another height half way, and is back at the
start only after the whole loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.shown import Brief
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import poses_of
from relmap.simulation.drive import lengths_along
from relmap.simulation.noise import Noise, check_arguments, draw_noise

LOOP_LENGTH_M = 740.0
LOOP_ITERATIONS = 900
HEIGHT_M = 40.0
"""Height gained half way round the loop."""
HALF_WIDTH_M = 15.0
HALF_HEIGHT_M = 10.0
"""Half width and half height of the tube around the path that contains the landmarks."""
RANGE_M = 80.0
HALF_VIEW_RAD = np.deg2rad(60.0)
"""Half angle of the sensor's view cone ahead, limited by its range."""
ROLL_RAD = np.deg2rad(5.0)
REACH_M = 12.0
"""Largest distance of a dynamic landmark from the centre of its motion, per coordinate."""
SPEED_M = (0.1, 0.4)
"""Slowest and fastest motion, metres per iteration."""


@dataclass(frozen=True, eq=False, repr=False)
class FigureEight(Brief):
    """A simulated run and its truth.

    Attributes
    ----------
    log : ObservationLog
        The observations, with ids.
    landmark_ids : (m,) int64
    landmarks_map : (m, 3) float64, map frame, metres
        Position of each landmark (for dynamic ones, the centre of their motion).
    status : (m,) str
        "static" or "dynamic".
    trajectory : (k, 4, 4) float64
        ``T_map_robot`` at each iteration.
    """

    log: ObservationLog
    landmark_ids: Ints
    landmarks_map: Floats
    status: NDArray[np.str_]
    trajectory: Floats


def simulate_figure_eight(
    density: float = 25.0,
    iterations: int = LOOP_ITERATIONS,
    noise: Noise = "gaussian",
    sigma: float = 0.05,
    dynamic: float = 0.0,
    seed: int = 0,
) -> FigureEight:
    """Drive the figure eight and observe its landmarks (sections IV and V, Figs 13 and 14).

    Parameters
    ----------
    density : float
        Landmarks per 100 units of path length; about 0.8 of them are visible at a time.
    iterations : int
        Number of scans; one loop is 900 of them, more iterations repeat it.
    noise : "gaussian" or "uniform"
        Distribution of the noise of each coordinate; both have the standard deviation `sigma`.
    sigma : float
        Standard deviation of each observed coordinate, metres.
    dynamic : float
        Fraction of moving landmarks, in [0, 1].
    seed : int
        Seed of everything random.

    Returns
    -------
    FigureEight

    Raises
    ------
    RelmapError
        If an argument is out of its range.
    """
    limits = [
        (0 < density <= 1e5, f"density is {density}; it must lie in (0, 100000]"),
        (1 <= iterations <= 10**7, f"iterations is {iterations}; it must lie in [1, 10000000]"),
        (0 <= dynamic <= 1, f"dynamic is {dynamic}; it must lie in [0, 1]"),
    ]
    check_arguments(noise, sigma, seed, *limits)
    rng = np.random.default_rng(seed)
    landmarks_map = _scatter_landmarks(density, rng)
    m = len(landmarks_map)
    moving = np.zeros(m, dtype=bool)
    moving[rng.permutation(m)[: round(dynamic * m)]] = True
    offsets = dynamic_offsets(int(moving.sum()), iterations, rng)
    trajectory = _frames(LOOP_LENGTH_M / LOOP_ITERATIONS * np.arange(iterations, dtype=np.float64))
    ids, points = [], []
    for T_map_robot, offset in zip(trajectory, offsets, strict=True):
        here = landmarks_map.copy()
        here[moving] += offset
        in_robot = (here - T_map_robot[:3, 3]) @ T_map_robot[:3, :3]
        distance = np.linalg.norm(in_robot, axis=1)
        ahead = in_robot[:, 0] >= distance * np.cos(HALF_VIEW_RAD)
        seen = np.flatnonzero(ahead & (distance <= RANGE_M))
        ids.append(seen)
        points.append(in_robot[seen] + draw_noise(noise, sigma, (len(seen), 3), rng))
    log, status = ObservationLog.of_scans(points, ids), np.where(moving, "dynamic", "static")
    return FigureEight(log, np.arange(m), landmarks_map, status, trajectory)


def dynamic_offsets(count: int, iterations: int, rng: np.random.Generator) -> Floats:
    """Draw the motion of dynamic landmarks, every kind in equal proportion.

    The kinds are constant velocity (turning back at the end of the reach), random walk, circling,
    and stop-and-go; the paper calls a landmark dynamic when its movement has nothing to do with
    the robot's (section I).

    `count`: number of landmarks. Returns (iterations, count, 3): offset of each landmark from the
    middle of its motion, metres.
    """
    speed = rng.uniform(*SPEED_M, count)
    heading = rng.uniform(0, 2 * np.pi, count)
    phase = rng.uniform(0, 4 * REACH_M, count)
    along = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    travelled = np.arange(iterations)[:, None] * speed + phase
    steps = rng.normal(0, 1, (iterations, count, 3)) * speed[:, None]
    radius = rng.uniform(3.0, 8.0, count)
    angle = travelled / radius
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    # Phases of motion and rest alternate, 10 to 40 iterations each.
    period, start = rng.uniform(20, 80, count), rng.uniform(0, 1, count)
    going = (np.arange(iterations)[:, None] / period + start) % 1 < 0.5
    ways = (
        _folded(travelled)[:, :, None] * along,
        _folded(np.cumsum(steps, axis=0) + REACH_M),
        circle * radius[:, None],
        _folded(np.cumsum(going * 2 * speed, axis=0) + phase)[:, :, None] * along,
    )
    kind = np.arange(count) % len(ways)
    return np.asarray(np.choose(kind[:, None], ways))


def _folded(travelled: Floats) -> Floats:
    """Return the position after a distance travelled back and forth within the reach."""
    return np.asarray(np.abs(travelled % (4 * REACH_M) - 2 * REACH_M) - REACH_M)


def _path(phase: Floats, half_size_m: float) -> Floats:
    """Return the points (k, 3) of the eight at phases (k,), one loop per 2 pi."""
    x = half_size_m * np.sin(phase)
    y = half_size_m / 2 * np.sin(2 * phase)
    z = HEIGHT_M / 2 * (1 - np.cos(phase))
    return np.column_stack([x, y, z])


@cache
def _loop() -> tuple[float, Floats, Floats]:
    """Return the half size of the loop, phases around it (n,), and the lengths (n,) up to them."""
    phase = np.linspace(0, 2 * np.pi, 20_001)
    half_size_m, high = 1.0, LOOP_LENGTH_M
    for _ in range(60):
        middle = (half_size_m + high) / 2
        short = lengths_along(_path(phase, middle))[-1] < LOOP_LENGTH_M
        half_size_m, high = (middle, high) if short else (half_size_m, middle)
    return half_size_m, phase, lengths_along(_path(phase, half_size_m))


def _frames(length_m: Floats) -> Floats:
    """Return the poses (k, 4, 4) at path lengths (k,): x ahead along the path, gently rolling."""
    half_size_m, phase, lengths = _loop()
    at = np.interp(length_m % LOOP_LENGTH_M, lengths, phase)
    step = 1e-5
    ahead = _path(at + step, half_size_m) - _path(at - step, half_size_m)
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    pitch = -np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))
    angles = np.column_stack([yaw, pitch, ROLL_RAD * np.sin(3 * at)])
    return poses_of(Rotation.from_euler("ZYX", angles), _path(at, half_size_m))


def _scatter_landmarks(density: float, rng: np.random.Generator) -> Floats:
    """Return landmark positions (m, 3) in a tube around the path, in random order."""
    m = max(1, round(density * LOOP_LENGTH_M / 100))
    frames = _frames(rng.uniform(0, LOOP_LENGTH_M, m))
    side = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, m)
    up = rng.uniform(-HALF_HEIGHT_M, HALF_HEIGHT_M, m)
    return np.asarray(frames[:, :3, 3] + side[:, None] * frames[:, :3, 1] + up[:, None] * [0, 0, 1])
