"""Worlds of point landmarks that are hard to associate, seen by imperfect sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import known_name
from relmap.core.shown import Brief
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import poses_of
from relmap.simulation.noise import check_arguments
from relmap.simulation.places import KINDS, driven, raised

REACH_M = 25.0
"""Range of the sensor."""
TILT_RAD = np.deg2rad(4.0)
"""Amplitudes of roll and pitch in space."""
UNEQUAL = 10.0
"""Ratio of the larger to the smaller noise, for anisotropic noise."""


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """Settings of the simulation; by default a planar city seen by an accurate sensor.

    Attributes
    ----------
    kind : str
        One of `relmap.simulation.places.KINDS`.
    length_m : float
        Length of the path, metres.
    iterations : int
        Scans along it.
    spacing_m : float
        Typical distance between neighbouring landmarks, metres.
    space : bool
        Whether planar kinds are lifted into space.
    sigma : float
        Standard deviation of a coordinate, metres; see `noise`.
    noise : str
        Noise model, one of `SENSORS`.
    missed : float
        Fraction of the detections that fail.
    spurious : float
        False detections, as a fraction of the true ones; uniform over the view, id -1.
    wrong_ids : float
        Fraction of the detections with the id of another landmark.
    turn_deg : float
        Rotation of the sensor to either side between two scans, in addition to following the path.
    view_deg : float
        Width of the view; 360 is all around.
    seed : int

    Raises
    ------
    RelmapError
        If one is out of its range.
    """

    kind: str = "streets"
    length_m: float = 600.0
    iterations: int = 400
    spacing_m: float = 4.0
    space: bool = False
    sigma: float = 0.05
    noise: str = "isotropic"
    missed: float = 0.0
    spurious: float = 0.0
    wrong_ids: float = 0.0
    turn_deg: float = 0.0
    view_deg: float = 120.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise a `RelmapError` for values out of range."""
        known_name(self.kind, list(KINDS), "kind of world")
        known_name(self.noise, list(SENSORS), "noise")
        shares = ("missed", "spurious", "wrong_ids")
        ranges = {"length_m": (10, 1e5), "iterations": (1, 10**6), "spacing_m": (0.1, 1e3)}
        ranges |= {"turn_deg": (0, 180), "view_deg": (1, 360)} | dict.fromkeys(shares, (0, 0.9))
        limits = [
            (
                low <= getattr(self, key) <= high,
                f"{key} is {getattr(self, key)}; it must lie in [{low}, {high:g}]",
            )
            for key, (low, high) in ranges.items()
        ]
        check_arguments("gaussian", self.sigma, self.seed, *limits)


@dataclass(frozen=True, eq=False, repr=False)
class World(Brief):
    """A simulated run and its truth.

    Attributes
    ----------
    log : ObservationLog
        The observations, with ids, some of which may be wrong; -1 for false detections.
    true_ids : (n,) int64
        The landmark that each observation is of, -1 for false detections.
    covariances : (n, d, d) float64, robot frame, metres squared
        Noise covariance of each observation.
    landmark_ids : (m,) int64
    landmarks_map : (m, 3) float64, map frame, metres
    status : (m,) str
        "static".
    trajectory : (k, 4, 4) float64
        ``T_map_robot`` at each iteration.
    """

    log: ObservationLog
    true_ids: Ints
    covariances: Floats
    landmark_ids: Ints
    landmarks_map: Floats
    status: NDArray[np.str_]
    trajectory: Floats


def simulate_world(spec: WorldSpec) -> World:
    """Drive through a world and observe its landmarks.

    Parameters
    ----------
    spec : WorldSpec

    Returns
    -------
    World
    """
    rng = np.random.default_rng(spec.seed)
    place = KINDS[spec.kind](spec.length_m, spec.spacing_m, rng)
    if spec.space and place.planar:
        place = raised(place, rng)
    d = 2 if place.planar else 3
    trajectory = _poses(*driven(place.way, spec.iterations), spec.turn_deg, d, rng)
    scans = [_seen(place.landmarks_map, T, d, spec, rng) for T in trajectory]
    true_ids = np.concatenate([ids for ids, _ in scans])
    m = len(place.landmarks_map)
    read = [_misread(ids, spec.wrong_ids, m, rng) for ids, _ in scans]
    points = np.concatenate([points for _, points in scans])
    covariances = covariances_of(points, spec.sigma, spec.noise)
    values, vectors = np.linalg.eigh(covariances)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    noise = roots @ rng.normal(size=(*points.shape, 1))
    log = ObservationLog.of_scans([points for _, points in scans], read)
    log = replace(log, points_robot=points + noise[:, :, 0])
    ids, status = np.arange(m), np.full(m, "static")
    return World(log, true_ids, covariances, ids, place.landmarks_map, status, trajectory)


def covariances_of(points_robot: Floats, sigma: float, noise: str) -> Floats:
    """Return the covariances (n, d, d), square metres, of points (n, d), robot frame.

    `points_robot` (n, d), metres. `sigma`: standard deviation of a coordinate, metres; at half the
    range if it depends on that. `noise`: one of `SENSORS`.
    """
    distance = np.maximum(np.linalg.norm(points_robot, axis=1), 1e-9)
    ray = points_robot / distance[:, None]
    along, across = SENSORS[noise](distance / (REACH_M / 2))
    outer = ray[:, :, None] * ray[:, None]
    within = np.eye(points_robot.shape[1]) - outer
    squared = (along**2)[:, None, None] * outer + (across**2)[:, None, None] * within
    return np.asarray(sigma**2 * squared)


SENSORS: dict[str, Callable[[Floats], tuple[Floats, Floats]]] = {
    "isotropic": lambda far: (np.ones_like(far), np.ones_like(far)),
    "range": lambda far: (np.full_like(far, UNEQUAL), np.ones_like(far)),
    "bearing": lambda far: (np.ones_like(far), UNEQUAL * far),
    "growing": lambda far: (np.maximum(far, 0.1), np.maximum(far, 0.1)),
    "stereo": lambda far: (np.maximum(UNEQUAL * far**2, 0.1), np.maximum(far, 0.1)),
}
"""Noise along and across the ray, in units of sigma, by the distance in half ranges: isotropic; ten
times larger in range; ten times larger in bearing; growing with the distance; of a stereo camera,
growing along the ray with the square of the distance."""


def _poses(at: Floats, ahead: Floats, turn_deg: float, d: int, rng: np.random.Generator) -> Floats:
    """Return poses (k, 4, 4) looking along the path and, optionally, turning to both sides."""
    steps = np.deg2rad(turn_deg) * rng.choice([-1.0, 1.0], len(at))
    steps[0] = 0.0
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0]) + np.cumsum(steps)
    tilt = (d == 3) * TILT_RAD * np.sin(np.arange(len(at))[:, None] / [17.0, 23.0])
    return poses_of(Rotation.from_euler("ZYX", np.column_stack([yaw, tilt])), at)


def _seen(
    landmarks_map: Floats, T_map_robot: Floats, d: int, spec: WorldSpec, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Return the detections of one scan, without noise: ids (n,) and points (n, d), robot frame."""
    points = ((landmarks_map - T_map_robot[:3, 3]) @ T_map_robot[:3, :3])[:, :d]
    half_view = np.deg2rad(spec.view_deg) / 2
    bearing = np.abs(np.arctan2(np.linalg.norm(points[:, 1:], axis=1), points[:, 0]))
    seen = (bearing <= half_view) & (np.linalg.norm(points, axis=1) <= REACH_M)
    ids = np.flatnonzero(seen)
    n_false = rng.poisson(spec.spurious * len(ids))
    ids = ids[rng.random(len(ids)) >= spec.missed]
    distance = REACH_M * rng.random(n_false) ** (1 / d)
    away = rng.normal(size=(n_false, d))
    away[:, 1:] *= rng.random((n_false, 1))
    turn = half_view * rng.uniform(-1, 1, n_false)
    false = np.zeros((n_false, d))
    false[:, 0], false[:, 1] = distance * np.cos(turn), distance * np.sin(turn)
    if d == 3:
        roll = rng.uniform(0, np.pi, n_false)
        false[:, 2] = false[:, 1] * np.sin(roll)
        false[:, 1] *= np.cos(roll)
    both = np.concatenate([ids, np.full(n_false, -1)])
    order = rng.permutation(len(both))
    return both[order], np.concatenate([points[ids], false])[order]


def _misread(ids: Ints, share: float, n_landmarks: int, rng: np.random.Generator) -> Ints:
    """Return the ids (n,) of a scan, some wrong: half swapped, half of other landmarks."""
    read = ids.copy()
    wrong = rng.permutation(np.flatnonzero((ids >= 0) & (rng.random(len(ids)) < share)))
    n_swapped = (len(wrong) + 1) // 4 * 2
    swapped, other = wrong[:n_swapped], wrong[n_swapped:]
    read[swapped] = ids[swapped.reshape(-1, 2)[:, ::-1].ravel()]
    elsewhere = rng.permutation(np.setdiff1d(np.arange(n_landmarks), ids))[: len(other)]
    read[other[: len(elsewhere)]] = elsewhere
    return read
