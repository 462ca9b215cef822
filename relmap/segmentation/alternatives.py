"""Alternative methods of finding planes, for comparison.

Vertical planes of a 3-D scan by open3d: RANSAC in sequence, and growing planar patches; and a
Gaussian mixture initialised with lines: a control for the wall-shaped component.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.segmentation.em.moves import widest_gap
from relmap.segmentation.wall import LEAST

UPRIGHT = np.cos(np.deg2rad(75.0))
"""The normal of a vertical plane points up or down by no more than this."""
BAND = 2.5
DRAWS = 300
MOST_PLANES = 60
PATCH_LEAST = 30
STEPS = 50


def _open3d() -> Any:
    """Return the library; RelmapError if it does not load, as without a system library."""
    try:
        import open3d
    except ImportError as error:
        raise RelmapError(
            f"open3d, which the methods ransac3d and patches need, does not load: {error}"
        ) from error
    return open3d


def _cloud(points: Floats) -> Any:
    open3d = _open3d()
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def sequential_labels(points: Floats, sigma: float, seed: int) -> Ints:
    """Return the plane (n,) of each point (n, 3): the largest first, split at gaps along it.

    Points of planes that are not vertical are removed; those planes are not returned.
    """
    _open3d().utility.random.seed(seed)
    labels, free, count = np.full(len(points), -1), np.arange(len(points)), 0
    band = BAND * max(sigma, 1e-6)
    for _ in range(MOST_PLANES):
        if len(free) < LEAST:
            break
        plane, inliers = _cloud(points[free]).segment_plane(band, 3, DRAWS)
        own = free[inliers]
        if len(own) < LEAST:
            break
        normal = np.asarray(plane[:3])
        if abs(normal[2]) <= UPRIGHT:
            t = points[own, :2] @ (-normal[1], normal[0])
            for part in _parts(own, t, sigma):
                if len(part) >= LEAST:
                    labels[part], count = count, count + 1
        free = np.setdiff1d(free, own, assume_unique=True)
    return labels


def _parts(own: Ints, t: Floats, sigma: float) -> list[Ints]:
    """Return points as the parts between gaps in their positions t along the plane."""
    gap = widest_gap(np.sort(t), sigma)
    if gap is None:
        return [own]
    upper = t > 0.5 * sum(gap)
    return _parts(own[~upper], t[~upper], sigma) + _parts(own[upper], t[upper], sigma)


def patch_labels(points: Floats) -> Ints:
    """Return the vertical patch (n,) of each point (n, 3), -1 for none.

    open3d's `detect_planar_patches` (Araujo and Oliveira, "A robust statistics approach for plane
    detection in unorganized point clouds", 2020). A point in two patches belongs to the larger.
    """
    labels = np.full(len(points), -1)
    if len(points) <= PATCH_LEAST:
        return labels
    cloud = _cloud(points)
    cloud.estimate_normals()
    boxes = cloud.detect_planar_patches(min_num_points=PATCH_LEAST)
    inside = [
        np.asarray(box.get_point_indices_within_bounding_box(cloud.points), dtype=np.int64)
        for box in boxes
        if abs(np.asarray(box.R)[2, 2]) <= UPRIGHT
    ]
    for k, rows in enumerate(sorted((rows for rows in inside if len(rows)), key=len)):
        labels[rows] = k
    return labels


def gaussian_labels(xy: Floats, labels: Ints, seed: int) -> Ints:
    """Return the component (n,) of each point (n, 2) after EM started from given labels.

    scikit-learn's `GaussianMixture` with full covariances; -1 only if there was no line.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    k = int(labels.max(initial=-1)) + 1
    if k == 0:
        return labels
    parts = [xy[labels == j] for j in range(k)]
    floor = 1e-12 * float(np.ptp(xy)) ** 2 * np.eye(2)
    covariances = np.array([np.cov(part.T, bias=True) for part in parts]) + floor
    model = GaussianMixture(
        k,
        reg_covar=float(floor[0, 0]),
        max_iter=STEPS,
        weights_init=np.array([len(part) for part in parts]) / (labels >= 0).sum(),
        means_init=np.array([part.mean(axis=0) for part in parts]),
        precisions_init=np.linalg.inv(covariances),
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the limit of fifty steps was reached
        return np.asarray(model.fit_predict(xy), dtype=np.int64)
