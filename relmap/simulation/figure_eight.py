"""The figure-eight world of sections IV and V: one robot, many point landmarks.

The path is a lemniscate of Gerono that climbs during its first half and descends during its
second (Fig. 13), so the robot crosses its own path at another height half way, and is back at the
start only after the whole loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.simulation.motion import dynamic_offsets
from relmap.simulation.noise import Noise, draw_noise

LOOP_LENGTH_M = 740.0
LOOP_ITERATIONS = 900
HEIGHT_M = 40.0
"""Height gained half way round the loop."""
HALF_WIDTH_M = 15.0
HALF_HEIGHT_M = 10.0
"""Landmarks stand in a tube of this half width and half height around the path."""
RANGE_M = 80.0
HALF_VIEW_RAD = np.deg2rad(60.0)
"""The sensor sees a cone of this half angle ahead, as far as its range."""
ROLL_RAD = np.deg2rad(5.0)


@dataclass(frozen=True, eq=False)
class FigureEight:
    """A simulated run and its truth.

    Attributes
    ----------
    log : ObservationLog
        What the robot saw, with ids.
    landmark_ids : (m,) int64
    landmarks_map : (m, 3) float64, map frame, metres
        Position of each landmark (of the dynamic ones, the middle of where they move).
    status : (m,) str
        "static" or "dynamic".
    trajectory : (k, 4, 4) float64
        ``T_map_robot`` at each iteration.
    """

    log: ObservationLog
    landmark_ids: NDArray[np.int64]
    landmarks_map: NDArray[np.float64]
    status: NDArray[np.str_]
    trajectory: NDArray[np.float64]


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
        Number of scans; one loop is 900 of them, more iterations go round again.
    noise : "gaussian" or "uniform"
        Distribution of the noise of each coordinate; both have the standard deviation `sigma`.
    sigma : float
        Standard deviation of each observed coordinate, metres.
    dynamic : float
        Share of the landmarks that move, in [0, 1].
    seed : int
        Seed of everything random.

    Raises
    ------
    RelmapError
        Where an argument is out of its range.
    """
    _validate(density, iterations, noise, sigma, dynamic, seed)
    rng = np.random.default_rng(seed)
    landmarks_map = _scatter_landmarks(density, rng)
    m = len(landmarks_map)
    moving = np.zeros(m, dtype=bool)
    moving[rng.permutation(m)[: round(dynamic * m)]] = True
    offsets = dynamic_offsets(int(moving.sum()), iterations, rng)
    trajectory = _trajectory(iterations)
    log = _observe(trajectory, landmarks_map, moving, offsets, noise, sigma, rng)
    status = np.where(moving, "dynamic", "static")
    return FigureEight(log, np.arange(m), landmarks_map, status, trajectory)


def _validate(
    density: float, iterations: int, noise: str, sigma: float, dynamic: float, seed: int
) -> None:
    limits = [
        (0 < density <= 1e5, f"density is {density}; it must lie in (0, 100000]"),
        (1 <= iterations <= 10**7, f"iterations is {iterations}; it must lie in [1, 10000000]"),
        (noise in get_args(Noise), f"noise is {noise!r}; it must be gaussian or uniform"),
        (0 <= sigma < 1e3, f"sigma is {sigma}; it must lie in [0, 1000) metres"),
        (0 <= dynamic <= 1, f"dynamic is {dynamic}; it is a share, in [0, 1]"),
        (seed >= 0, f"seed is {seed}; it must not be negative"),
    ]
    for holds, message in limits:
        if not holds:
            raise RelmapError(message)


def _path(phase: NDArray[np.float64], half_size_m: float) -> NDArray[np.float64]:
    """Return the points (k, 3) of the eight at phases (k,), one loop per 2 pi."""
    x = half_size_m * np.sin(phase)
    y = half_size_m / 2 * np.sin(2 * phase)
    z = HEIGHT_M / 2 * (1 - np.cos(phase))
    return np.column_stack([x, y, z])


def _phase_of_length() -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the half size that makes the loop as long as it must be, and phase over length."""
    phase = np.linspace(0, 2 * np.pi, 20_001)

    def lengths(half_size_m: float) -> NDArray[np.float64]:
        steps = np.linalg.norm(np.diff(_path(phase, half_size_m), axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    low, high = 1.0, LOOP_LENGTH_M
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if lengths(middle)[-1] < LOOP_LENGTH_M else (low, middle)
    return low, phase, lengths(low)


def _frames(length_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the poses (k, 4, 4) at path lengths (k,): x ahead along the path, gently rolling."""
    half_size_m, phase, lengths = _phase_of_length()
    at = np.interp(length_m % LOOP_LENGTH_M, lengths, phase)
    step = 1e-5
    ahead = _path(at + step, half_size_m) - _path(at - step, half_size_m)
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    pitch = -np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))
    roll = ROLL_RAD * np.sin(3 * at)
    poses = np.tile(np.eye(4), (len(at), 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])).as_matrix()
    poses[:, :3, 3] = _path(at, half_size_m)
    return poses


def _trajectory(iterations: int) -> NDArray[np.float64]:
    return _frames(LOOP_LENGTH_M / LOOP_ITERATIONS * np.arange(iterations, dtype=np.float64))


def _scatter_landmarks(density: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return landmark positions (m, 3) in a tube around the path, in random order."""
    m = max(1, round(density * LOOP_LENGTH_M / 100))
    frames = _frames(rng.uniform(0, LOOP_LENGTH_M, m))
    side = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, m)
    up = rng.uniform(-HALF_HEIGHT_M, HALF_HEIGHT_M, m)
    return np.asarray(frames[:, :3, 3] + side[:, None] * frames[:, :3, 1] + up[:, None] * [0, 0, 1])


def _observe(
    trajectory: NDArray[np.float64],
    landmarks_map: NDArray[np.float64],
    moving: NDArray[np.bool_],
    offsets: NDArray[np.float64],
    noise: Noise,
    sigma: float,
    rng: np.random.Generator,
) -> ObservationLog:
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
    counts = [len(seen) for seen in ids]
    n = sum(counts)
    return ObservationLog(
        points_robot=np.concatenate(points),
        iteration=np.repeat(np.arange(len(trajectory)), counts),
        rows=np.arange(n),
        first_iteration=0,
        end_iteration=len(trajectory),
        ids=np.concatenate(ids).astype(np.int64),
    )
