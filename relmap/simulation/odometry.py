"""Simulated wheel odometry of a known path, with noise, biases and faults."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.odometry import motions, path_of, poses_at, relative
from relmap.datasets.scans import poses_of

UPRIGHT = 1 - 1e-12
"""The cosine of zero tilt, up to rounding."""


@dataclass(frozen=True, kw_only=True)
class Wheels:
    """Errors of odometry.

    Attributes
    ----------
    way : float
        Standard deviation of each coordinate of a step, as a fraction of its length.
    turn_deg, turn_deg_per_m : float
        Standard deviation of its rotation about each axis, degrees, and its increase per metre.
    way_bias, turn_bias_deg_per_m : float
        Systematic errors: a fraction of the distance, and degrees to the left per metre.
    """

    way: float = 0.01
    turn_deg: float = 0.1
    turn_deg_per_m: float = 0.0
    way_bias: float = 0.0
    turn_bias_deg_per_m: float = 0.0

    def __post_init__(self) -> None:
        """Raise a `RelmapError` for values out of range."""
        for name in (field.name for field in fields(self)):
            low, value = -90 if "bias" in name else 0, getattr(self, name)
            if not low <= value <= 90:
                raise RelmapError(f"{name} of wheels is {value}; it must lie in [{low}, 90]")


def wheel_odometry(poses: Floats, wheels: Wheels, rng: np.random.Generator) -> Floats:
    """Return the motions (k, 4, 4) measured by wheels on a path.

    `poses` (k, 4, 4): ``T_map_robot`` of each iteration; planar if none has height, roll or pitch.
    Returns (k, 4, 4): motion from the previous iteration to each one; NaN for the first.
    """
    true = motions(poses)[1:]
    planar = not np.ptp(poses[:, 2, 3]) and bool((poses[:, 2, 2] > UPRIGHT).all())
    free = np.array([1, 1, 0]) if planar else np.ones(3)
    way = np.linalg.norm(true[:, :3, 3], axis=1)[:, None]
    step = (1 + wheels.way_bias) * true[:, :3, 3]
    step += wheels.way * way * free * rng.normal(size=(len(true), 3))
    sigma = np.deg2rad(wheels.turn_deg + wheels.turn_deg_per_m * way)
    turn = sigma * rng.normal(size=(len(true), 3)) * ([0, 0, 1] if planar else free)
    turn[:, 2:] += np.deg2rad(wheels.turn_bias_deg_per_m) * way
    counted = Rotation.from_matrix(true[:, :3, :3]) * Rotation.from_rotvec(turn)
    return np.concatenate([np.full((1, 4, 4), np.nan), poses_of(counted, step)])


def slipping(odometry: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Return motions (k, 4, 4) that count the translation of a fraction of the steps twice."""
    slipped = odometry.copy()
    slips = rng.choice(len(odometry), round(share * len(odometry)), replace=False)
    slipped[slips, :3, 3] *= 2
    return slipped


def backward(odometry: Floats) -> Floats:
    """Return motions (k, 4, 4) that report backward for forward, with mirrored rotation."""
    return relative(odometry, np.eye(4))


def stale(odometry: Floats, at: Floats, late: float) -> Floats:
    """Return motions (k, 4, 4) between times (k,) as they were that much earlier.

    Motions before the first time, and next to unknown motions, are unknown.
    """
    found = motions(poses_at(at, path_of(odometry), at - late))
    unknown = np.asarray(np.isnan(odometry).any(axis=(1, 2)))
    unknown[0] = False
    before = np.clip(np.searchsorted(at, at - late), 1, len(at) - 1)
    around = unknown[before] | unknown[np.roll(before, 1)] | unknown[before - 1]
    found[around] = np.nan
    return found
