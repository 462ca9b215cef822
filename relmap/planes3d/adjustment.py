"""Plane adjustment: least squares over planes and poses, with the poses eliminated.

The points of a plane in a scan are condensed into their directions and spread. These give the sum
of squared distances from any plane exactly, up to a constant (as the point clusters of BALM do,
Z. Liu and F. Zhang, RA-L 2021; see `relmap.segmentation.space.Patches`).
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.gauss_newton import gauss_newton
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations

STRETCH = 8
"""Number of scans whose equations are summed before they are added to the sparse matrix."""
LOOSE_POSE, LOOSE, LEAST = 1e-10, 1e-12, 1e-9
"""Damping of poorly determined poses and planes, as a fraction of the diagonal, and its least value
for planes."""
FARTHEST_RAD, FARTHEST = 0.5, 0.3
"""Largest rotation of a step, and largest translation as a fraction of the size of the map."""
ROUNDING = 1e-14
"""Residuals below this fraction of the range are rounding errors."""
DOUBTFUL = 4.0
"""Residual, in standard deviations, at which a weight is halved. It never vanishes (Cauchy): a
scan may depend on one observation."""
ROUNDS, GAIN = 30, 1e-6
"""Maximum number of steps, and the gain of a step that ends them."""
SHARES: list[float] = [0.0, *np.geomspace(0.01, 3.0, 60).tolist()]
"""Common errors that are tried, as fractions of the noise."""
NORMAL = 0.6745
"""Median absolute value of a normal distribution, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Observations of planes: n, robot frame.

    `scan`, `plane` (n,): numbered from 0 without gaps; scans ascend. `centre` (n, 3); `axes`
    (n, 3, 3); `information`, `spread` (n, 3): see `relmap.segmentation.space.Patches`.
    """

    scan: Ints
    plane: Ints
    centre: Floats
    axes: Floats
    information: Floats
    spread: Floats


@dataclass(frozen=True, eq=False)
class Scene:
    """Poses and planes, the unknowns.

    `R` (p, 3, 3), `t` (p, 3): ``T_map_robot``; `normal` (l, 3); `base` (l, 3): a point near each
    plane; `off` (l,): distance of each plane from its base, along the normal.
    """

    R: Floats
    t: Floats
    normal: Floats
    base: Floats
    off: Floats


class PlaneAdjustment:
    """Residuals of observed planes; a `Problem`.

    `systematic`: error that the points of an observation have in common, as a fraction of their
    noise; `free`, dict of int to (k, 3): scans and the directions, robot frame, at most three, in
    which their position is kept because planes determine it poorly.
    """

    def __init__(
        self, seen: Sightings, systematic: float = 0.0, free: dict[int, Floats] | None = None
    ) -> None:
        self.seen, self._free = seen, free or {}
        self._root = np.sqrt(information(seen, systematic))
        self._latest: tuple[Scene, Linearised] | None = None
        n_planes, stretch = int(seen.plane.max()) + 1, seen.scan // STRETCH
        self.pattern = Pattern.of_pairs(np.full(n_planes, 3), stretch, seen.plane)
        kept = self.pattern.first[seen.plane][:, None] + np.arange(3)
        poses = np.arange(int(seen.scan.max()) + 1)
        starts = 3 * np.searchsorted(seen.scan, np.append(poses, len(poses)))
        rows, moves = np.arange(3 * len(seen.scan)), (poses > 0).astype(np.float64)
        self._poses = Elimination(
            self.pattern, np.repeat(kept, 3, axis=0), starts, rows, poses // STRETCH, free=moves
        )
        self.freedoms = max(len(rows) - self.pattern.n_unknowns - 6 * (len(poses) - 1), 1)
        least = ROUNDING * np.linalg.norm(seen.centre, axis=1)
        self.rounding = float(((least * self._root[:, 2]) ** 2).sum())

    def solve(self, scene: Scene, least_gain: float = GAIN) -> Scene:
        """Return the least-squares scene; the first pose is fixed.

        `least_gain`: gain of a step that ends it, in squared standard deviations of the whole map.
        """
        return gauss_newton(self, scene, self.weights, ROUNDS, unsure=least_gain).state

    def systematic_share(self, scene: Scene) -> float:
        """Return the error common to the points of an observation, as a fraction of their noise.

        With it the median residual is that of a normal distribution.
        """
        spare = np.sqrt(self.freedoms / len(self._root) / 3)
        off = self.residuals(scene).reshape(-1, 3) / self._root

        def is_enough(share: float) -> bool:
            size = np.abs(off * np.sqrt(information(self.seen, share)))
            return bool(np.median(size) <= NORMAL * spare)

        return SHARES[bisect_left(SHARES[:-1], True, key=is_enough)]

    def weights(self, residual: Floats) -> Floats:
        """Return the weights (3 n,) of residuals, by the norm of the three of an observation."""
        size = np.sqrt((residual.reshape(-1, 3) ** 2).sum(axis=1))
        return np.repeat(1 / (1 + (size / DOUBTFUL) ** 2), 3)

    def residuals(self, state: Scene) -> Floats:
        """Return the residuals (3 n,) of each observation: tilt along u, along v, and distance."""
        return self.linearised(state).off

    def equations(
        self, state: Scene, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations of the planes."""
        along = np.zeros((len(state.R), 3, 6))
        for scan, directions in self._free.items():
            along[scan, : len(directions), 3:] = directions @ state.R[scan].T
        linear, hold = self.linearised(state), LOOSE_POSE + damping
        found = self._poses.equations(linear, weight, hold, with_matrix, along)
        if with_matrix:
            self.pattern.hold(found.matrix, LOOSE + damping, LEAST)
        return found

    def stepped(
        self, state: Scene, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Scene | None:
        """Return the scene after a step; None if the step is too large."""
        poses = equations.eliminated_steps(step)
        poses[0] = 0.0
        planes = step[self.pattern.first[:, None] + np.arange(3)]
        farthest_m = FARTHEST * float(np.ptp(np.concatenate([state.t, state.base]), axis=0).max())
        turned = max(np.abs(poses[:, :3]).max(), np.abs(planes[:, :2]).max())
        if turned > FARTHEST_RAD or np.abs(poses[:, 3:]).max() > farthest_m:
            return None
        e, f = across(state.normal)
        normal = state.normal + planes[:, :1] * e + planes[:, 1:2] * f
        return replace(
            state,
            R=Rotation.from_rotvec(poses[:, :3]).as_matrix() @ state.R,
            t=state.t + poses[:, 3:],
            normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
            off=state.off + planes[:, 2],
        )

    def linearised(self, state: Scene) -> Linearised:
        """Return residuals and Jacobians; those of the last state are cached."""
        if self._latest is None or self._latest[0] is not state:
            self._latest = state, _linearised(self.seen, state, self._root)
        return self._latest[1]


def information(seen: Sightings, systematic: float) -> Floats:
    """Return the information (n, 3) of observations whose points have an error in common."""
    lever = np.column_stack([seen.spread[:, :2], np.ones(len(seen.scan))])
    shared = systematic * seen.spread[:, 2:] / np.maximum(lever, 1e-9)
    return np.asarray(1 / (1 / np.maximum(seen.information, 1e-12) + shared**2))


def across(normal: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (l, 3) each, perpendicular to the normals and to each other."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    e = np.cross(normal, axis)
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    return e, np.cross(normal, e)


def _linearised(seen: Sightings, state: Scene, root: Floats) -> Linearised:
    R, n = state.R[seen.scan], state.normal[seen.plane]
    u, v = (np.einsum("nij,nj->ni", R, seen.axes[:, k]) for k in (0, 1))
    arm = np.einsum("nij,nj->ni", R, seen.centre)
    x = arm + state.t[seen.scan] - state.base[seen.plane]
    off = np.column_stack([(u * n).sum(1), (v * n).sum(1), (x * n).sum(1) - state.off[seen.plane]])
    by_pose = np.zeros((len(n), 3, 6))
    by_pose[:, :, :3] = np.cross(np.stack([u, v, arm], axis=1), n[:, None])
    by_pose[:, 2, 3:] = n
    e, f = (axis[seen.plane] for axis in across(state.normal))
    by_plane = np.zeros((len(n), 3, 3))
    lever = np.stack([u, v, x], axis=1)
    by_plane[:, :, 0], by_plane[:, :, 1] = (np.einsum("nki,ni->nk", lever, g) for g in (e, f))
    by_plane[:, 2, 2] = -1.0
    scale = root[..., None]
    return Linearised(
        (off * root).ravel(), (by_pose * scale).reshape(-1, 6), (by_plane * scale).reshape(-1, 3)
    )
