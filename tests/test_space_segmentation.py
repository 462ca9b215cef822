"""Planes of any direction out of clouds: found, measured and condensed."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import RelmapError
from relmap.core.arrays import Floats
from relmap.segmentation.space import Patches, PatchSegmenter
from relmap.segmentation.space.growing import condensed
from relmap.simulation.storey import Storey, simulate_storey

LARGE_M2, MANY = 0.25, 150


def board(
    centre: list[float], u: list[float], v: list[float], sigma: float = 0.0, n: int = 40
) -> Floats:
    """Return points (n * n, 3) on a parallelogram, noisy across it."""
    rng = np.random.default_rng(5)
    a, b = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.5, 0.5, n)] * 2))
    across = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    off = sigma * rng.standard_normal((n * n, 1)) * across
    return np.asarray(np.array(centre) + a[:, None] * u + b[:, None] * v + off)


def true_planes(world: Storey, k: int) -> Floats:
    """Return normals to the sensor and offsets (f, 4) of the faces, in the frame of a scan."""
    R, t = world.trajectory[k, :3, :3], world.trajectory[k, :3, 3]
    sides = world.corners[:, [1, 3]] - world.corners[:, :1]
    normal = np.cross(sides[:, 0], sides[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = ((world.corners[:, 0] - t) * normal).sum(axis=1)
    sign = np.where(offset > 0, -1.0, 1.0)
    return np.column_stack([(normal @ R) * sign[:, None], offset * sign])


def squares(points: Floats, weight: Floats, normal: Floats, offset: float) -> float:
    return float(weight @ (points @ normal - offset) ** 2)


def condensed_squares(patches: Patches, k: int, normal: Floats, offset: float) -> float:
    turned = patches.axes[k, :2] @ normal
    across = patches.centre[k] @ normal - offset
    return float(patches.information[k] @ np.append(turned, across) ** 2)


@pytest.mark.parametrize("sensor", ["lidar", "depth"])
def test_planes_without_noise_are_exact(sensor: str) -> None:
    world = simulate_storey(sensor, 0.0, 3)  # type: ignore[arg-type]
    for k, scan in enumerate(world.scans):
        segmenter = PatchSegmenter().fit(scan)
        found, truth = segmenter.patches_, true_planes(world, k)
        assert len(found) >= (4 if sensor == "lidar" else 1)
        for patch in range(len(found)):
            mine = world.faces[k][segmenter.labels_ == patch]
            face = np.bincount(mine).argmax()
            assert np.abs(found.normal[patch] - truth[face, :3]).max() < 1e-9
            assert abs(found.offset[patch] - truth[face, 3]) < 1e-9


def test_large_planes_are_found_once_under_noise() -> None:
    world = simulate_storey("lidar", 0.01, 12)
    hits = large = right = wrong = 0
    for k, scan in enumerate(world.scans):
        segmenter = PatchSegmenter().fit(scan)
        labels, truth = segmenter.labels_, world.plane_of[world.faces[k]]
        for patch in range(len(segmenter.patches_)):
            share = np.bincount(truth[labels == patch]).max() / (labels == patch).sum()
            if 12 * segmenter.patches_.spread[patch, :2].prod() >= LARGE_M2:
                right, wrong = right + (share >= 0.9), wrong + (share < 0.9)
        for plane in np.unique(truth):
            mine = truth == plane
            if mine.sum() < MANY:
                continue
            extent = np.sqrt(np.linalg.eigvalsh(np.cov(scan[mine].T))[1:])
            if 12 * extent.prod() < LARGE_M2 or extent[0] < 0.1:
                continue
            large += 1
            hits += np.bincount(labels[mine] + 1, minlength=2)[1:].max() > 0.5 * mine.sum()
    assert large > 60
    assert hits >= 0.95 * large
    assert right >= 0.95 * (right + wrong)


def test_condensed_scatter_gives_the_squares_of_the_points() -> None:
    points = board([2.0, 0.5, 1.0], [0.0, 2.0, 0.0], [0.3, 0.0, 1.5], sigma=0.005)
    segmenter = PatchSegmenter(min_points=30).fit(points)
    patches = segmenter.patches_
    assert len(patches) == 1
    mine = points[segmenter.labels_ == 0]
    # The noise gives the weights, and the thickness their scale.
    weight = segmenter.noise_m_[segmenter.labels_ == 0] ** -2
    weight *= len(mine) / squares(mine, weight, patches.normal[0], patches.offset[0])
    best = float(len(mine))
    for tilt in ([0.02, 0.0, 0.0], [0.0, 0.0, -0.03]):
        normal = patches.normal[0] + tilt
        normal /= np.linalg.norm(normal)
        offset = patches.offset[0] + 0.004
        direct = squares(mine, weight, normal, offset)
        assert condensed_squares(patches, 0, normal, offset) == pytest.approx(
            direct - best, rel=0.1
        )
        plane = np.append(normal, -offset)
        whole = float(plane @ patches.scatter[0] @ plane)
        assert whole == pytest.approx(direct, rel=0.1)


def mean_errors(normals: Floats, offsets: Floats, sigma: float, growing: bool) -> Floats:
    """Return the mean errors (m, 3) of the planes of 20 noisy scans, in standard deviations.

    `normals` (m, 3), `offsets` (m,): planes, of which a ray ends at the first; `growing`: whether
    the noise grows with the square of the range. The errors are tilt along u and v, and distance.
    """
    rng, sums = np.random.default_rng(0), np.zeros((len(normals), 3))
    for _ in range(20):
        rays = np.insert(np.tan(rng.uniform(-0.6, 0.6, (8000, 2))), 0, 1.0, axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        ahead = rays @ normals.T
        range_m = np.where(ahead > 0, offsets / np.maximum(ahead, 1e-9), np.inf).min(axis=1)
        range_m += sigma * (range_m**2 / 9 if growing else 1.0) * rng.standard_normal(len(rays))
        found = PatchSegmenter().fit(range_m[:, None] * rays).patches_
        for k, row in enumerate((found.normal @ normals.T).argmin(axis=0)):
            off = np.append(found.axes[row, :2] @ normals[k], found.centre[row] @ normals[k])
            sums[k] += (off - [0.0, 0.0, offsets[k]]) * np.sqrt(found.information[row])
    return sums / 20


CORNER = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]), np.array([3.0, 1.0, 1.0])


@pytest.mark.parametrize(("sigma", "growing"), [(0.05, False), (0.02, True)])
def test_noise_does_not_shift_planes_that_meet(sigma: float, growing: bool) -> None:
    # Points of one plane are taken for another's, and near points count more where noise grows.
    assert np.abs(mean_errors(*CORNER, sigma, growing)[:, 2]).max() < 1.0


@pytest.mark.parametrize("growing", [False, True])
def test_noise_does_not_tilt_oblique_planes(growing: bool) -> None:
    normal = np.array([[0.8, 0.6, 0.0]])
    assert np.abs(mean_errors(normal, np.array([2.5]), 0.05, growing)).max() < 1.0


def test_points_that_may_be_of_another_plane_count_only_if_most_points_are() -> None:
    wall = board([2.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    floor = board([1.5, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    points = np.concatenate([wall, floor]) - [0.0, 0.0, 1.0]
    label, noise_m = np.repeat([0, 1], 1600), np.full(3200, 0.02)
    *_, number = condensed(points, label, noise_m, 0.1)
    assert (number < 1550).all()
    assert (number > 1300).all()
    strip = points[:1600, 2] < -0.95
    kept = np.append(strip, np.ones(1600, dtype=bool))
    *_, number = condensed(points[kept], label[kept], noise_m[kept], 0.1)
    assert number[0] == strip.sum()
    assert number[1] < 1550


def test_coplanar_boards_are_one_and_a_step_makes_two() -> None:
    def two(step_m: float) -> Floats:
        far = board([3.0 + step_m, 1.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0], 0.005)
        return np.concatenate(
            [board([3.0, -1.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0], 0.005), far]
        )

    assert len(PatchSegmenter().fit(two(0.0)).patches_) == 1
    assert len(PatchSegmenter().fit(two(0.08)).patches_) == 2


@pytest.mark.parametrize("n", [0, 1, 59])
def test_few_points_show_nothing(n: int) -> None:
    segmenter = PatchSegmenter().fit(np.ones((n, 3)))
    assert len(segmenter.patches_) == 0
    assert segmenter.labels_.tolist() == [-1] * n


def test_points_all_at_the_sensor_show_nothing() -> None:
    assert len(PatchSegmenter().fit(np.zeros((500, 3))).patches_) == 0


def test_clutter_shows_no_plane() -> None:
    points = np.random.default_rng(1).uniform(-3, 3, (4000, 3))
    assert len(PatchSegmenter().fit(points).patches_) == 0


@pytest.mark.parametrize(
    ("points", "wrong"),
    [(np.ones((9, 2)), "2 columns"), (np.full((9, 3), np.nan), "finite"), ("abc", "array")],
)
def test_other_arrays_than_clouds_are_refused(points: object, wrong: str) -> None:
    with pytest.raises(RelmapError, match=wrong):
        PatchSegmenter().fit(points)  # type: ignore[arg-type]


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_points_at_the_sensor_of_rays_without_a_return_change_nothing(share: float) -> None:
    cloud = simulate_storey("depth", 0.01, 1).scans[0]
    missing = np.zeros((int(len(cloud) * share / (1 - share)), 3))
    whole = PatchSegmenter().fit(cloud).patches_
    found = PatchSegmenter().fit(np.concatenate([missing, cloud])).patches_
    assert len(found) > 0
    np.testing.assert_array_equal(found.centre, whole.centre)
    np.testing.assert_array_equal(found.cells, whole.cells)
