"""The segmenter on simulated scenes, judged by their truth, and on input that has no planes."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest

import relmap
from relmap import PlaneSegmenter, RelmapError
from relmap.core.arrays import Floats, Ints
from relmap.planes.scans.beams import GivenBeams
from relmap.segmentation import Planes
from relmap.segmentation.em.mixture import WallMixture
from relmap.segmentation.ends.corners import meet
from relmap.segmentation.segmenter import planes_of
from relmap.simulation import BuildingScan, building_scene, simulate_building
from relmap.simulation.sensor import Sampling
from tests.worlds import turn

VIEW_RAD = np.pi / 2
RANGE_M = 8.0
FIELDS = ("midpoint", "normal", "ends", "size", "z_extent", "noise", "n_points")


def segmented(scan: BuildingScan) -> PlaneSegmenter:
    return PlaneSegmenter(view_rad=VIEW_RAD, range_m=RANGE_M).fit(scan.points)


def matches(scan: BuildingScan, labels: Ints) -> list[tuple[int, int]]:
    """Return each wall with 1 % of the points and the plane that shares 80 % with it, or -1."""
    pairs = []
    for row in np.flatnonzero(np.bincount(scan.stretch) >= 0.01 * len(scan.points)):
        own = scan.stretch == row
        best, found = -1, labels[own & (labels >= 0)]
        for plane in np.unique(found):
            shared = (found == plane).sum()
            if shared >= 0.8 * max(own.sum(), (labels == plane).sum()):
                best = int(plane)
        pairs.append((int(row), best))
    return pairs


@pytest.mark.parametrize(("sigma", "least"), [(0.0, 0.97), (0.05, 0.9), (0.1, 0.9), (0.3, 0.65)])
def test_walls_are_found(sigma: float, least: float) -> None:
    found = []
    for seed in range(2000, 2006):
        scan = building_scene(seed, sigma=sigma)
        found += [plane >= 0 for _, plane in matches(scan, segmented(scan).labels_)]
    assert np.mean(found) >= least


def test_without_noise_planes_and_corners_are_exact() -> None:
    for seed in range(2000, 2005):
        scan = building_scene(seed, sigma=0.0, sample_ends=True)
        segmenter = segmented(scan)
        planes = segmenter.planes_
        assert segmenter.noise_ <= 1e-8
        assert len(list(matches(scan, segmenter.labels_))) > 1
        for row, plane in matches(scan, segmenter.labels_):
            assert plane >= 0
            along = scan.seen.ends[row, 1] - scan.seen.ends[row, 0]
            assert abs(planes.normal[plane] @ along) < 1e-9
            whole = scan.seen.end_type[row] == "corner"
            assert np.abs(planes.ends[plane] - scan.seen.ends[row])[whole].max(initial=0) < 1e-9


def test_corners_are_unbiased_and_their_types_right() -> None:
    outward, types = [], []
    for seed in range(2000, 2015):
        scan = building_scene(seed, sigma=0.05)
        segmenter = segmented(scan)
        planes = segmenter.planes_
        for row, plane in matches(scan, segmenter.labels_):
            if plane < 0:
                continue
            along = scan.seen.ends[row, 1] - scan.seen.ends[row, 0]
            along /= np.linalg.norm(along)
            for side in (0, 1):
                true, found = scan.seen.end_type[row, side], planes.end_type[plane, side]
                types.append((true, found))
                if true == "corner":
                    off = planes.ends[plane, side] - scan.seen.ends[row, side]
                    outward.append(off @ along * (2 * side - 1))
    assert abs(np.median(outward)) < 0.005
    assert np.median(np.abs(outward)) < 0.02
    right = sum(true == found == "corner" for true, found in types)
    assert right >= 0.93 * sum(found == "corner" for _, found in types)
    assert right >= 0.88 * sum(true == "corner" for true, _ in types)


def test_planes_keep_their_conventions() -> None:
    scan = building_scene(2001, sigma=0.05)
    segmenter = segmented(scan)
    planes, labels = segmenter.planes_, segmenter.labels_
    m = len(planes)
    assert m > 1
    assert labels.dtype == np.int64
    assert labels.shape == (2000,)
    np.testing.assert_array_equal(planes.n_points, np.bincount(labels[labels >= 0], minlength=m))
    assert (planes.n_points > 0).all()
    np.testing.assert_allclose(np.linalg.norm(planes.normal, axis=1), 1)
    assert ((planes.normal * -planes.midpoint[:, :2]).sum(axis=1) > 0).all(), "to the sensor"
    right, left = planes.ends[:, 0], planes.ends[:, 1]
    assert (right[:, 0] * left[:, 1] - right[:, 1] * left[:, 0] > 0).all(), "right to left"
    np.testing.assert_allclose(planes.size, np.linalg.norm(left - right, axis=1))
    np.testing.assert_allclose(planes.midpoint[:, :2], (left + right) / 2)
    np.testing.assert_allclose(planes.midpoint[:, 2], planes.z_extent.mean(axis=1))
    for k in range(m):
        off = (scan.points[labels == k, :2] - right[k]) @ planes.normal[k]
        assert planes.noise[k] == pytest.approx(np.sqrt(np.mean(off**2)))
    assert segmenter.noise_ == pytest.approx(0.05, rel=0.1)


def test_same_scan_and_seed_give_the_same_bits() -> None:
    scan = building_scene(2002, 9000, sigma=0.1)
    first, second = segmented(scan), segmented(scan)
    np.testing.assert_array_equal(first.labels_, second.labels_)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(first.planes_, name), getattr(second.planes_, name))


@pytest.mark.parametrize("angle", [0.7, 2.5, -1.9])
def test_turning_the_scan_turns_the_planes(angle: float) -> None:
    """Without limits of the view a scan does not show which direction is ahead."""
    scan = building_scene(2003, sigma=0.0, sample_ends=True)
    turned = np.column_stack([scan.points[:, :2] @ turn(angle).T, scan.points[:, 2]])
    before, after = PlaneSegmenter().fit(scan.points), PlaneSegmenter().fit(turned)
    order = np.argsort(before.planes_.size)
    again = np.argsort(after.planes_.size)
    np.testing.assert_allclose(
        before.planes_.ends[order] @ turn(angle).T, after.planes_.ends[again], atol=1e-6
    )


@pytest.mark.parametrize("method", ["em", "ransac", "mixture"])
def test_every_method_finds_two_plain_walls(method: str) -> None:
    rng = np.random.default_rng(0)
    across = np.column_stack([np.full(600, 4.0), rng.uniform(-2, 2, 600), rng.uniform(0, 2, 600)])
    beside = np.column_stack([rng.uniform(1, 4, 600), np.full(600, 2.0), rng.uniform(0, 2, 600)])
    points = np.vstack([across, beside]) + rng.normal(0, 0.03, (1200, 3))
    planes = PlaneSegmenter(method).fit(points).planes_
    assert len(planes) == 2
    order = np.argsort(planes.size)
    np.testing.assert_allclose(planes.size[order], [3, 4], atol=0.1)
    np.testing.assert_allclose(planes.normal[order], [[0, -1], [-1, 0]], atol=0.03)
    np.testing.assert_allclose(planes.z_extent, [[0, 2], [0, 2]], atol=0.1)


@pytest.mark.parametrize("method", ["ransac3d", "patches"])
def test_open3d_knows_a_floor_from_walls(method: str) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(1500, 4.0), rng.uniform(-3, 3, 1500), rng.uniform(0, 3, 1500)])
    floor = np.column_stack(
        [rng.uniform(1, 4, (3000, 1)), rng.uniform(-3, 3, (3000, 1)), np.zeros((3000, 1))]
    )
    points = np.vstack([wall, floor]) + rng.normal(0, 0.01, (4500, 3))
    segmenter = PlaneSegmenter(method, noise=0.01).fit(points)
    assert len(segmenter.planes_) >= 1
    largest = int(segmenter.planes_.n_points.argmax())
    np.testing.assert_allclose(segmenter.planes_.normal[largest], [-1, 0], atol=0.03)
    assert (segmenter.labels_[1500:] >= 0).mean() < 0.1


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((0, 2)),
        np.ones((1, 3)),
        np.ones((1, 2)),
        np.ones((50, 3)),
        np.random.default_rng(0).normal(size=(2, 3)),
        np.random.default_rng(0).uniform(-5, 5, (1500, 3)),
        np.random.default_rng(0).normal(size=(1500, 3)),
    ],
    ids=["none", "none-2d", "one", "one-2d", "one-place", "two", "even", "blob"],
)
def test_a_scan_without_walls_has_no_planes(points: Floats) -> None:
    segmenter = PlaneSegmenter().fit(points)
    assert isinstance(segmenter.planes_, Planes)
    assert len(segmenter.planes_) == 0
    assert (segmenter.labels_ == -1).all()
    assert segmenter.labels_.shape == (len(points),)


@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_a_single_line_is_one_plane(sigma: float) -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([np.full(400, 2.0), np.linspace(-1, 1, 400), np.zeros(400)])
    planes = PlaneSegmenter().fit(points + rng.normal(0, sigma, points.shape)).planes_
    assert len(planes) == 1
    assert planes.size[0] == pytest.approx(2, abs=0.02 if sigma else 1e-9)


def test_a_million_points_take_no_longer_than_needed() -> None:
    rng = np.random.default_rng(0)
    half = 500_000
    points = np.zeros((2 * half, 3))
    points[:half] = np.column_stack([np.full(half, 3.0), *rng.uniform(-2, 2, (2, half))])
    points[half:] = np.column_stack(
        [rng.uniform(0, 3, half), np.full(half, 2.0), rng.uniform(-2, 2, half)]
    )
    segmenter = PlaneSegmenter().fit(points + rng.normal(0, 0.05, points.shape))
    assert len(segmenter.planes_) == 2
    assert (segmenter.labels_[:half] == segmenter.labels_[0]).mean() > 0.97


@pytest.mark.parametrize("kind", ["even", "blob"])
def test_a_million_points_of_no_wall_do_not_hang(kind: str) -> None:
    rng = np.random.default_rng(1)
    shape = (1_000_000, 3)
    points = rng.uniform(-5, 5, shape) if kind == "even" else rng.normal(size=shape)
    begin = process_time()
    assert len(PlaneSegmenter().fit(points).planes_) == 0
    assert process_time() - begin < 200


def test_walls_under_uniform_noise_are_not_doubled() -> None:
    found, surplus = [], 0
    for seed in range(2000, 2010):
        scan = building_scene(seed, sigma=0.1, noise="uniform")
        segmenter = segmented(scan)
        found += [plane >= 0 for _, plane in matches(scan, segmenter.labels_)]
        surplus += len(segmenter.planes_) > len(np.unique(scan.stretch))
    assert np.mean(found) >= 0.9
    assert surplus == 0


@pytest.mark.parametrize(
    ("arguments", "points", "part"),
    [
        ({}, [[1.0, 2.0, np.nan]], "points row 0"),
        ({}, [[1.0, 2.0, 3.0], [np.inf, 0, 0]], "points row 1"),
        ({}, [1.0, 2.0], "(2,)"),
        ({}, np.zeros((3, 4)), "(3, 4)"),
        ({}, "abc", "array of numbers"),
        ({}, [["1", "2", "3"]], "array of numbers"),
        ({}, [[1j, 2.0, 3.0]], "array of numbers"),
        ({"method": "best"}, np.zeros((3, 3)), "em, ransac"),
        ({"method": "patches"}, np.zeros((3, 2)), "(n, 3)"),
        ({"noise": -1.0}, np.zeros((3, 3)), "noise"),
        ({"view_rad": 0.0}, np.zeros((3, 3)), "view_rad"),
        ({"view_rad": 180}, np.zeros((3, 2)), "it must be radians, 2 pi at most"),
        ({"range_m": np.nan}, np.zeros((3, 3)), "range_m"),
        ({"range_m": "8"}, np.zeros((3, 3)), "range_m is '8'"),
        ({"noise": True}, np.zeros((3, 3)), "noise is True"),
        ({"noise": np.full(1000, 0.1)}, np.zeros((3, 3)), "noise is array"),
        ({"random_state": -1}, np.zeros((3, 3)), "random_state is -1; it must be a whole number"),
        ({"random_state": 1.5}, np.zeros((3, 3)), "random_state is 1.5"),
        ({"random_state": 2**32}, np.zeros((3, 3)), "random_state is 4294967296"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    arguments: dict[str, object], points: object, part: str
) -> None:
    segmenter = PlaneSegmenter(**arguments)  # type: ignore[arg-type]
    with pytest.raises(RelmapError) as caught:
        segmenter.fit(points)  # type: ignore[arg-type]
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("sampling", ["surface", "laser"])
def test_points_at_the_sensor_of_rays_without_a_return_change_nothing(sampling: Sampling) -> None:
    points = simulate_building(200, 0.01, sampling=sampling, iterations=1).scans[0].points
    points = points[:, :2] if sampling == "laser" else points
    some = np.sort(np.random.default_rng(0).integers(0, len(points), len(points)))
    missing = np.insert(points, some, 0.0, axis=0)
    found, whole = PlaneSegmenter().fit(missing), PlaneSegmenter().fit(points)
    assert len(found.planes_) > 2
    np.testing.assert_array_equal(found.planes_.ends, whole.planes_.ends)
    np.testing.assert_array_equal(found.labels_, np.insert(whole.labels_, some, -1))
    beams, given = (GivenBeams.checked(each, np.zeros(2)) for each in (points, missing))
    np.testing.assert_array_equal(given.points, beams.points)


def test_exported_from_the_package() -> None:
    assert relmap.PlaneSegmenter is PlaneSegmenter


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", ["em", "ransac", "mixture", "scanlines"])
def test_odd_scans_make_no_warnings(method: str) -> None:
    """Far away the length of a small wall is lost in rounding."""
    rng = np.random.default_rng(1)
    near = rng.normal(size=(40, 2))
    for far_m in (1.0, 1e6, 1e9):
        for n in (2, 3, 5):
            clumps = np.repeat(rng.uniform(-1, 1, (n, 2)) * far_m, 12, axis=0)
            for points in (
                clumps,
                np.vstack([clumps, near]),
                np.vstack([clumps, near + far_m / 2]),
            ):
                planes = PlaneSegmenter(method, noise=0.1).fit(points).planes_
                assert np.isfinite(planes.normal).all()
                assert (planes.size > 0).all()


@pytest.mark.parametrize("far_m", [1e10, 1e160, np.inf, np.nan])
def test_points_that_no_sensor_sees_are_refused(far_m: float) -> None:
    with pytest.raises(RelmapError, match="must be finite, in metres, and at most 1e\\+09"):
        PlaneSegmenter().fit(np.array([[0.0, 1.0], [far_m, 2.0], [3.0, 4.0]]))


@pytest.mark.filterwarnings("error")
def test_a_wall_whose_length_is_lost_in_rounding_is_none() -> None:
    rows = [[5e8, 1.0, 1.0, 0.0, 0.0, 1e-9, 0.5], [2.0, -1.0, 0.0, 1.0, 0.0, 2.0, 0.5]]
    xy = np.array([[5e8, 1.0]] * 9 + [[2.0, 0.25 * k - 1] for k in range(9)])
    sharp = meet(WallMixture(np.array(rows), 0.01, 0.0, 1.0), len(xy))
    labels, planes = planes_of(xy, sharp, np.repeat([0, 1], 9))
    assert labels.tolist() == [-1] * 9 + [0] * 9
    np.testing.assert_allclose(planes.size, [2.0])
