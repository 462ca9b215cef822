"""2-D lasers with few beams: the points required for a wall depend on how well they fit."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper, PlaneSegmenter
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.segmentation.scanline.lines import LaserScan, beam_noise, scan_walls
from relmap.simulation import simulate_building
from relmap.simulation.building import building_scene
from tests.worlds import ate_m

ONE_DEGREE = 181


def beams(distance_m: float, count: int, step_deg: float = 1.0) -> Floats:
    """Return the points of beams on a wall ahead, with noise of 5 mm."""
    bearing = np.deg2rad(step_deg) * (np.arange(count) - 0.5 * (count - 1))
    reach = distance_m / np.cos(bearing) + np.random.default_rng(0).normal(0, 0.005, count)
    return np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])


@pytest.mark.parametrize(
    ("distance_m", "count", "walls"), [(8.0, 4, 1), (1.0, 5, 0), (1.0, 8, 1), (0.1, 8, 0)]
)
def test_a_long_line_needs_fewer_points(distance_m: float, count: int, walls: int) -> None:
    assert len(scan_walls(LaserScan(beams(distance_m, count), 0.005))[0].walls) == walls


@pytest.mark.parametrize("length", [100, 10, 5])
def test_the_noise_is_not_larger_if_walls_have_few_points(length: int) -> None:
    """Of the triples of neighbours two in so many lie across the end of a wall."""
    found = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 0.01, 200)
        step = np.arange(200) // length % 2
        found.append(beam_noise(np.column_stack([step + noise, 0.3 * np.arange(200)])))
    assert np.mean(found) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("count", [361, 721, 1081, 2000])
def test_points_closer_than_the_noise_do_not_cut_walls(count: int) -> None:
    """The chord from one neighbour to the next is then nearly along the beam."""
    building = simulate_building(points=count, sampling="laser", seed=55, iterations=60)
    segmenter = PlaneSegmenter()
    found = [len(segmenter.fit(scan.points[:, :2]).planes_) for scan in building.scans[::10]]
    assert 5 <= np.median(found) <= 8
    noise = [beam_noise(scan.points[:, :2]) for scan in building.scans]
    assert np.median(noise) == pytest.approx(0.05, rel=0.5)
    assert min(noise) > 0.4 * 0.05


@pytest.mark.parametrize("sigma_m", [0.01, 0.02, 0.03, 0.05, 0.1])
@pytest.mark.parametrize("count", [181, 361, 721, 1081, 2000, 4000])
def test_the_noise_does_not_depend_on_the_number_of_beams(count: int, sigma_m: float) -> None:
    """Across oblique walls less of the noise of the ranges is seen."""
    bearing = np.linspace(-np.pi, np.pi, count, endpoint=False)
    to_corner = np.abs(np.column_stack([np.cos(bearing), np.sin(bearing)]))
    found = []
    for seed, room_m in enumerate([(4.5, 1.3), (6.0, 4.0), (8.0, 2.0), (3.0, 3.0)]):
        range_m = (room_m / np.maximum(to_corner, 1e-9)).min(axis=1)
        range_m += np.random.default_rng(seed).normal(0.0, sigma_m, count)
        xy = range_m[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        found.append(beam_noise(xy) / sigma_m)
    assert min(found) > 0.6
    assert max(found) < 1.1


@pytest.mark.parametrize("width", [2, 3])
def test_clutter_is_not_noise_of_points_that_are_close(width: int) -> None:
    """The distances of points among boxes grow with the number of beams between."""
    bearing, found = np.deg2rad(np.arange(ONE_DEGREE) - 90.0), []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        depth = np.repeat(rng.uniform(0, 1, ONE_DEGREE // width + 1), width)[:ONE_DEGREE]
        reach = 1.5 + depth + rng.normal(0, 0.005, ONE_DEGREE)
        found.append(
            beam_noise(np.column_stack([np.cos(bearing), np.sin(bearing)]) * reach[:, None])
        )
    assert max(found) < 0.05


def test_most_walls_are_found_with_one_beam_a_degree() -> None:
    found = []
    for seed in range(15):
        scan = building_scene(seed, ONE_DEGREE, 0.01, sampling="laser")
        labels = PlaneSegmenter(view_rad=np.pi, range_m=8.0).fit(scan.points[:, :2]).labels_
        for row in np.flatnonzero(np.bincount(scan.stretch) >= 4):
            own = labels[scan.stretch == row]
            plane = int(np.bincount(own + 1, minlength=2)[1:].argmax())
            share = (own == plane).mean() * (scan.stretch[labels == plane] == row).mean()
            found.append(share > 0.64)
    assert np.mean(found) > 0.85


def test_a_building_is_mapped_with_one_beam_a_degree() -> None:
    """With eight points a wall at least, this map was torn: its path was off by 8 m."""
    building = simulate_building(points=ONE_DEGREE, sigma=0.01, seed=0, sampling="laser")
    mapper = PlaneMapper()
    segmenter = PlaneSegmenter(view_rad=np.pi, range_m=8.0)
    for scan in building.scans:
        mapper.update(segmenter.fit(scan.points[:, :2]).planes_)
    mapper.finish()
    mapper.refine()
    assert ate_m(mapper.trajectory, building.trajectory) < 0.06


def test_points_that_are_repeated_change_nothing() -> None:
    points = building_scene(0, ONE_DEGREE, 0.01, sampling="laser").points[:, :2]
    once, twice = (PlaneSegmenter().fit(np.repeat(points, n, axis=0)) for n in (1, 2))
    assert len(once.planes_.ends) > 3
    np.testing.assert_array_equal(twice.planes_.ends, once.planes_.ends)
    np.testing.assert_array_equal(twice.labels_, np.repeat(once.labels_, 2))


@pytest.mark.parametrize("offset_m", [0.0, 40.0])
def test_beams_must_be_in_their_order(offset_m: float) -> None:
    """A laser may be anywhere on the robot, and turn either way."""
    seen = building_scene(3, ONE_DEGREE, 0.01, sampling="laser").points[:, :2] + [offset_m, 0.0]
    for ordered in (seen, seen[::-1], np.roll(seen, 70, axis=0)):
        assert len(PlaneSegmenter().fit(ordered).planes_) > 3
    rng, segmenter = np.random.default_rng(0), PlaneSegmenter()
    for _ in range(4):
        segmenter.fit(rng.permutation(seen))
    with pytest.raises(RelmapError, match="not in the order of the beams"):
        segmenter.fit(rng.permutation(seen))
    PlaneSegmenter(method="em").fit(rng.permutation(seen))


def test_a_laser_among_leaves_is_in_order() -> None:
    """Successive beams end far apart."""
    rng, segmenter = np.random.default_rng(0), PlaneSegmenter()
    bearing = np.linspace(-np.pi / 2, np.pi / 2, 181)
    for _ in range(6):
        range_m = rng.uniform(0.5, 10.0, 181)
        segmenter.fit(range_m[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)]))


@pytest.mark.parametrize("first", [0, 100, 250])
@pytest.mark.parametrize("order", [1, -1])
def test_walls_have_no_corner_where_a_scan_all_round_begins(first: int, order: int) -> None:
    """The first beam is in the middle of a wall; the ends of the view are not estimated either."""
    bearing = np.deg2rad(np.roll(np.arange(-179.9, 180.0, 0.5), first))[::order]
    ranges = np.minimum(3 / np.abs(np.cos(bearing)), 2 / np.abs(np.sin(bearing)))
    points = ranges[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    planes = PlaneSegmenter().fit(points).planes_
    corners = planes.ends[planes.end_type == "corner"]
    np.testing.assert_allclose(np.abs(corners), 4 * [[3.0, 2.0], [3.0, 2.0]], atol=0.01)
