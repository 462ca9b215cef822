"""Odometry: measured motions of the robot from one iteration to the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.motion_noise import MotionNoise
from relmap.core.scan import FARTHEST_M, numbers
from relmap.core.state.growing import GrowingArray
from relmap.core.state.table import NONE

WANTED = (
    "(3,) x, y, yaw; (7,) x, y, z, qx, qy, qz, qw; or a (4, 4) pose of the robot in its frame "
    "one iteration before"
)
RIGID = 1e-6
"""Tolerance of the orthogonality of a rotation, for files rounded to six digits or more."""


def checked_odometry(odometry: ArrayLike) -> Floats:
    """Return a motion as a new pose (4, 4) float64.

    `odometry` (3,), (7,) or (4, 4) array of numbers: the robot's pose in its frame one iteration
    before, metres and radians: x, y, yaw; x, y, z and a quaternion, scalar last; or a matrix.
    Unknown if all values are NaN. Raises `RelmapError` if the shape is wrong, a value is not
    finite, or the rotation is invalid.
    """
    array = numbers(odometry, "odometry", WANTED)
    if array.shape not in ((3,), (7,), (4, 4)):
        raise RelmapError(f"odometry has shape {array.shape}; it must be {WANTED}")
    if not (np.abs(array) <= FARTHEST_M).all():
        if np.isnan(array).all():
            return np.full((4, 4), np.nan)
        raise RelmapError(
            f"odometry is {array.tolist()}; it must be finite, in metres and radians, and at most "
            f"{FARTHEST_M:g}"
        )
    return _of_matrix(array) if array.ndim == 2 else _of_numbers(array)


def motion_from_velocity(
    speed_m_s: float | Floats, yaw_rate_rad_s: float | Floats, duration_s: float | Floats
) -> Floats:
    """Return the motion at constant speed and rate of turn: an arc of a circle.

    Parameters
    ----------
    speed_m_s : float or (n,) array
        Forward speed; negative in reverse.
    yaw_rate_rad_s : float or (n,) array
        Positive to the left.
    duration_s : float or (n,) array

    Returns
    -------
    (3,) or (3, n) float64
        x, y, metres, and yaw, radians, in the frame at the start.
    """
    way, yaw = speed_m_s * duration_s, yaw_rate_rad_s * duration_s
    along, across = np.sinc(yaw / np.pi), np.sin(yaw / 2) * np.sinc(yaw / (2 * np.pi))
    return np.array([way * along, way * across, yaw])


@dataclass(frozen=True, eq=False)
class OdometryUse:
    """How odometry was used in the map.

    `noise`: its constant errors and noise, estimated from landmarks; `is_used`: whether the map
    depends on it: not if landmarks connect all scans, nor if odometry is rejected as a whole,
    `is_wrong`; `left_out` (l,): iterations whose odometry was rejected; `hanging` (h,): iterations
    connected to the previous one by odometry only; `poses` (k, 4, 4), metres: of each iteration in
    the frame of its submap, NaN where undetermined; `submap` (k,): its number among those of the
    engine, or `NONE`; `sigmas` (3,): noise of observations and of the distances and turns of
    odometry, relative to `noise`; `drift`: that found at revisited places, relative to that
    expected from noise, by which covariances are scaled; `alike`: number of landmarks of places
    that look the same, which odometry tells apart; `of_two_places` (l,): ids that name two places
    each, and are not mapped.
    """

    noise: MotionNoise
    is_used: bool
    left_out: Ints
    hanging: Ints
    poses: Floats
    submap: Ints
    sigmas: Floats
    is_wrong: bool
    drift: float = 1.0
    alike: int = 0
    of_two_places: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @classmethod
    def of(cls, noise: MotionNoise, slipped: Bools) -> OdometryUse:
        """Return a record of odometry that was checked, but not used.

        `slipped` (k,): iterations in which landmarks contradict it.
        """
        none = np.empty(0, dtype=np.int64)
        left_out, poses = np.flatnonzero(slipped), np.empty((0, 4, 4))
        return cls(noise, False, left_out, none, poses, none, np.ones(3), noise.is_wrong)

    def poses_in(self, submap: int) -> Floats:
        """Return the poses (k, 4, 4) in the frame of one submap; NaN in others, and of none."""
        inside = (self.submap == submap) & (submap != NONE)
        return np.where(inside[:, None, None], self.poses, np.nan)


class Motions:
    """The odometry of a run, a pose for each iteration; empty in runs without."""

    STATE = "_motion"

    def __init__(self) -> None:
        self._motion: GrowingArray[np.float64] = GrowingArray(np.float64, (4, 4))

    def __len__(self) -> int:
        """Return the number of iterations up to the last one with a row; 0 before any motion."""
        return len(self._motion)

    def append(self, motion: Floats | None, iteration: int) -> None:
        """Add the motion (4, 4) to an iteration; None or NaN if unknown, as that into the first."""
        if motion is not None or len(self):
            self._motion.resize(iteration, np.nan)
            self._motion.append(np.nan if motion is None or iteration == 0 else motion)

    def between(self, begin: int, end: int) -> Floats:
        """Return the motions to iterations begin:end (end - begin, 4, 4), NaN if unknown."""
        known = self._motion.values[begin:end]
        return np.concatenate([known, np.full((end - begin - len(known), 4, 4), np.nan)])

    def over(self, n_iterations: int) -> Floats:
        """Return the motion to each iteration (n_iterations, 4, 4); NaN if unknown."""
        return self.between(0, n_iterations)


def _of_numbers(array: Floats) -> Floats:
    motion = np.eye(4)
    if len(array) == 3:
        motion[:2, 3] = array[:2]
        c, s = np.cos(array[2]), np.sin(array[2])
        motion[:2, :2] = [[c, -s], [s, c]]
        return motion
    if not np.linalg.norm(array[3:]) > RIGID:
        raise RelmapError(
            f"odometry has the quaternion {array[3:].tolist()}, which is not a rotation"
        )
    motion[:3, 3], motion[:3, :3] = array[:3], Rotation.from_quat(array[3:]).as_matrix()
    return motion


def _of_matrix(array: Floats) -> Floats:
    # In every scan: numpy's functions for a single small matrix would take most of the time.
    (a, b, c, _), (d, e, f, _), (g, h, i, _), last = array.tolist()
    far = (
        *(a * a + b * b + c * c - 1, d * d + e * e + f * f - 1, g * g + h * h + i * i - 1),
        *(a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i),
        *(last[0], last[1], last[2], last[3] - 1),
    )
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if determinant <= 0 or max(map(abs, far)) > RIGID:
        raise RelmapError(f"odometry is {array.tolist()}; it must be a rotation and a translation")
    return array
