"""The parts of segmentation against closed forms and other libraries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.optimize import minimize
from scipy.stats import norm

from relmap import PlaneSegmenter
from relmap.segmentation.em import wall_kernels
from relmap.segmentation.em.mixture import WallMixture, maximise, scan_area
from relmap.segmentation.em.moves import bend, merge, split, widest_gap
from relmap.segmentation.em.wall_kernels import expect
from relmap.segmentation.ends.corners import meet
from relmap.segmentation.ends.end_kernels import box_extent
from relmap.segmentation.ends.end_types import type_ends
from relmap.segmentation.noise import beam_angle, window_noise
from relmap.segmentation.scanline.lines import LaserScan, first_and_last, hidden_ends, scan_walls
from relmap.segmentation.wall import one_hides_other
from tests.kernels import callable_here


def wall(x0: float, y0: float, x1: float, y1: float, share: float = 1.0) -> list[float]:
    """Return a wall from its first end to its second."""
    length = float(np.hypot(x1 - x0, y1 - y0))
    return [x0, y0, (x1 - x0) / length, (y1 - y0) / length, 0.0, length, share]


def on_wall(rng: np.random.Generator, row: list[float], n: int, sigma: float) -> np.ndarray:
    """Return points (n, 2) evenly along a wall, with noise."""
    t = rng.uniform(row[4], row[5], n)[:, None]
    return np.asarray(np.array(row[:2]) + t * np.array(row[2:4]) + rng.normal(0, sigma, (n, 2)))


def test_tables_are_the_normal_distribution() -> None:
    step, bell = callable_here(wall_kernels.gauss_step), callable_here(wall_kernels.bell)
    for x in np.linspace(-7, 7, 401):
        assert step(x) == pytest.approx(norm.cdf(x), abs=1e-6)
        assert bell(x) == pytest.approx(np.exp(-0.5 * x * x), abs=1e-6)


@pytest.mark.parametrize("beam", [0.0, 0.01])
def test_density_of_a_wall_integrates_to_its_share(beam: float) -> None:
    walls = np.array([wall(2.0, -1.0, 2.5, 0.8, 0.6)])

    def density(y: float, x: float) -> float:
        return float(expect(np.array([[x, y]]), walls, 0.15, np.zeros(1), beam)[1][0])

    total, _ = dblquad(density, 1.0, 3.5, -2.2, 2.0, epsabs=1e-4)
    assert total == pytest.approx(0.6, rel=5e-3 if beam else 1e-3)


def test_weighted_line_is_the_first_principal_axis() -> None:
    rng = np.random.default_rng(1)
    xy = rng.normal(size=(200, 2)) @ [[2.0, 0.7], [0.1, 0.3]] + [5, -3]
    weight = rng.uniform(0, 1, 200)
    fitted = np.array(wall(0, 0, 1, 0))
    callable_here(wall_kernels.weighted_line)(xy, weight, fitted)
    mean = weight @ xy / weight.sum()
    _, vectors = np.linalg.eigh(((xy - mean) * weight[:, None]).T @ (xy - mean))
    assert abs(fitted[2:4] @ vectors[:, 1]) == pytest.approx(1)
    np.testing.assert_allclose(fitted[:2], mean)


def test_ends_of_a_blurred_box_are_those_of_greatest_likelihood() -> None:
    rng = np.random.default_rng(2)
    sigma = 0.1
    t = rng.uniform(1.0, 4.0, 600) + rng.normal(0, sigma, 600)

    def loss(ends: np.ndarray) -> float:
        box = norm.cdf((t - ends[0]) / sigma) - norm.cdf((t - ends[1]) / sigma)
        return float(600 * np.log(ends[1] - ends[0]) - np.log(np.maximum(box, 1e-300)).sum())

    best = minimize(loss, [t.min() + 0.1, t.max() - 0.1], method="Nelder-Mead")
    np.testing.assert_allclose(box_extent(t, sigma), best.x, atol=0.01)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
def test_ends_of_a_blurred_box_are_unbiased(sigma: float) -> None:
    """The outermost points are off by two to three standard deviations."""
    rng = np.random.default_rng(3)
    ends = np.array(
        [box_extent(rng.uniform(0, 3, 500) + rng.normal(0, sigma, 500), sigma) for _ in range(200)]
    )
    off = ends - [0, 3]
    assert np.abs(off.mean(axis=0)).max() < 3 * off.std() / np.sqrt(200) + 0.006


def test_ends_without_noise_are_the_outermost_points() -> None:
    t = np.random.default_rng(4).uniform(1, 2, 100)
    assert box_extent(t, 0.0) == (t.min(), t.max())


def test_em_recovers_two_walls_from_a_rough_start() -> None:
    rng = np.random.default_rng(5)
    true = [wall(4, -2, 4, 2, 0.6), wall(4, 2, 1, 2, 0.4)]
    xy = np.vstack([on_wall(rng, true[0], 1200, 0.1), on_wall(rng, true[1], 800, 0.1)])
    rough = np.array([wall(4.2, -1.5, 3.9, 1.5, 0.5), wall(3.5, 2.2, 1.5, 1.9, 0.5)])
    fitted = maximise(WallMixture(rough, 0.3, 0.05, scan_area(xy, 0.3)), xy, 200)
    assert fitted.sigma == pytest.approx(0.1, rel=0.06)
    assert fitted.stray < 0.01
    np.testing.assert_allclose(fitted.walls[:, 6], [0.6, 0.4], atol=0.03)
    np.testing.assert_allclose(np.abs(fitted.walls[:, 2]), [0, 1], atol=0.02)
    np.testing.assert_allclose(np.ptp(fitted.walls[:, 4:6], axis=1), [4, 3], atol=0.12)


def test_em_raises_the_likelihood() -> None:
    rng = np.random.default_rng(6)
    xy = on_wall(rng, wall(3, -1, 3.5, 1.5), 500, 0.08)
    mixture = WallMixture(np.array([wall(3.2, -0.5, 3.2, 1.0)]), 0.2, 0.05, scan_area(xy, 0.2))
    before = mixture.likelihood(xy)
    for _ in range(12):
        mixture = maximise(mixture, xy, 1)
        assert mixture.likelihood(xy) > before - 1e-2
        before = mixture.likelihood(xy)


def mixture_of(walls: list[list[float]], xy: np.ndarray, sigma: float) -> WallMixture:
    return WallMixture(np.array(walls), sigma, 0.001, scan_area(xy, sigma))


@pytest.mark.parametrize(("gap", "count"), [(0.0, 1), (0.9, 2)])
def test_touching_pieces_of_a_line_are_one_wall_and_a_door_parts_them(
    gap: float, count: int
) -> None:
    rng = np.random.default_rng(7)
    pieces = [wall(3, -2, 3, 0, 0.5), wall(3, gap, 3, 2 + gap, 0.5)]
    xy = np.vstack([on_wall(rng, piece, 500, 0.05) for piece in pieces])
    apart = mixture_of(pieces, xy, 0.05)
    assert len(merge(apart, xy).walls) == count
    whole = mixture_of([wall(3, -2, 3, 2 + gap)], xy, 0.05)
    assert len(split(whole, xy).walls) == count


def test_a_bent_wall_is_two() -> None:
    rng = np.random.default_rng(8)
    true = [wall(4, -1.5, 4, 0.5, 0.5), wall(4, 0.5, 2.5, 1.5, 0.5)]
    xy = np.vstack([on_wall(rng, one, 500, 0.1) for one in true])
    assert len(bend(mixture_of([wall(4.3, -1.5, 3, 1.6)], xy, 0.1), xy).walls) == 2
    straight = on_wall(rng, wall(4, -1.5, 4, 1.5), 1000, 0.1)
    assert len(bend(mixture_of([wall(4, -1.5, 4, 1.5)], straight, 0.1), straight).walls) == 1


def test_gap_is_found_where_it_is() -> None:
    rng = np.random.default_rng(9)
    t = np.sort(np.concatenate([rng.uniform(0, 3, 300), rng.uniform(4, 6, 200)]))
    gap = widest_gap(t + 0.0, 0.01)
    np.testing.assert_allclose(gap, (3, 4), atol=0.08)
    assert widest_gap(np.sort(rng.uniform(0, 5, 500)), 0.01) is None


@pytest.mark.parametrize("sigma", [0.01, 0.05, 0.15])
def test_noise_is_seen_in_windows(sigma: float) -> None:
    rng = np.random.default_rng(10)
    rows = [wall(5, -4, 5, 4), wall(5, 4, -3, 4), wall(-3, 4, -3, -4)]
    xy = np.vstack([on_wall(rng, row, 700, sigma) for row in rows])
    assert window_noise(xy, rng) == pytest.approx(sigma, rel=0.15)


def test_walls_meet_in_their_crossing() -> None:
    """Ends that stop short of one another by less than their accuracy belong together."""
    walls = np.array([wall(4, -2, 4.001, 1.95, 0.5), wall(3.96, 2, 1, 2, 0.5)])
    met = meet(WallMixture(walls, 0.05, 0.001, 20.0), 2000)
    ends = [
        w[:2] + t * w[2:4]
        for w, t in (
            (met.mixture.walls[0], met.mixture.walls[0, 5]),
            (met.mixture.walls[1], met.mixture.walls[1, 4]),
        )
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    np.testing.assert_array_equal(met.joined, [[False, True], [True, False]])
    far = np.array([wall(4, -2, 4, 1.0, 0.5), wall(3.0, 2, 1, 2, 0.5)])
    assert not meet(WallMixture(far, 0.05, 0.001, 20.0), 2000).joined.any()


def test_noise_does_not_hide_a_wall_that_is_seen_at_a_flat_angle() -> None:
    flat, behind = np.array(wall(3.65, 2.76, 4.58, 3.82)), np.array(wall(5.12, 3.34, 4.6, 3.75))
    assert one_hides_other(flat, behind, 0.01)
    assert not one_hides_other(flat, behind, 0.2)


def test_types_of_ends_in_their_order() -> None:
    half, reach = np.deg2rad(45), 8.0
    ends = np.array(
        [
            [[3.0, -3.0], [3.0, 0.0]],  # from the right edge of the view to a free end
            [[6.0, 0.0], [6.0, 2.0]],  # begins behind the first one's left end
            [[7.0, 2.5], [5.0, np.sqrt(64 - 25) * 0.7]],  # free, both of them
            [[4.0, np.sqrt(48) * 0.5], [7.0, np.sqrt(15)]],  # ends at the range
        ]
    )
    spread, (joined, hidden) = np.full((4, 2), 0.01), np.zeros((2, 4, 2), dtype=bool)
    kinds = type_ends(ends, spread, joined, (float(half), reach), hidden)
    assert kinds[0].tolist() == ["view", "corner"]
    assert kinds[1].tolist() == ["occluded", "corner"]
    assert kinds[3, 1] == "range"
    joined[1, 0] = True
    assert type_ends(ends, spread, joined, (float(half), reach), hidden)[1, 0] == "corner"


def test_a_wall_hides_what_is_behind_it_straight_behind_the_sensor() -> None:
    ends = np.array([[[-3.0, 3.0], [-3.0, -1e-3]], [[-6.0, 1e-3], [-6.0, -2.0]]])
    spread, (joined, hidden) = np.full((2, 2), 0.01), np.zeros((2, 2, 2), dtype=bool)
    kinds = type_ends(ends, spread, joined, (np.inf, np.inf), hidden)
    assert kinds.tolist() == [["corner", "corner"], ["occluded", "corner"]]


def test_a_point_on_the_line_of_a_wall_that_leads_to_the_sensor_has_no_density() -> None:
    xy = np.array([[2.0, 0.0], [-1.0, 0.0]])
    walls = np.array([wall(-1, 0, 3, 0)])
    density, total = expect(xy, walls, 0.01, np.full(2, 1e-3), np.deg2rad(1.0))
    np.testing.assert_array_equal(density, 0.0)
    np.testing.assert_array_equal(total, 1e-3)
    line = np.column_stack([np.linspace(-1, 1, 50), np.zeros(50)])
    assert np.isfinite(PlaneSegmenter("em").fit(line).noise_)


def test_a_laser_scan_of_a_room_is_four_walls() -> None:
    bearing = np.deg2rad(np.arange(-180, 180, 0.5))
    reach = np.minimum(3 / np.abs(np.cos(bearing)), 2 / np.abs(np.sin(bearing) + 1e-12))
    xy = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])
    mixture, labels = scan_walls(LaserScan(xy))
    assert len(mixture.walls) in (4, 5)  # the scan begins in the middle of one
    assert (labels < 0).sum() <= 4  # at most the beams into the corners
    distance = np.abs(
        mixture.walls[:, 0] * mixture.walls[:, 3] - mixture.walls[:, 1] * mixture.walls[:, 2]
    )
    assert set(np.round(distance, 6)) == {2.0, 3.0}


def corridor(bearing: np.ndarray, door: tuple[float, float], beyond: float) -> np.ndarray:
    """Return what beams meet of a wall at y = 1 with a door, through which they see y = beyond."""
    x = 1 / np.tan(bearing)
    y = np.where((x > door[0]) & (x < door[1]), beyond, 1.0)
    xy = np.column_stack([y / np.tan(bearing), y])
    return np.asarray(xy[np.hypot(*xy.T) < 8])


@pytest.mark.parametrize("beyond", [2.5, 100.0], ids=["a room beyond", "nothing beyond"])
def test_a_door_seen_at_a_flat_angle_parts_a_wall(beyond: float) -> None:
    xy = corridor(np.deg2rad(np.arange(5, 60, 0.5)), (4.5, 5.7), beyond)
    _, labels = scan_walls(LaserScan(xy, 0.01))
    own = [labels[(xy[:, 1] == 1.0) & side] for side in (xy[:, 0] < 4.5, xy[:, 0] > 5.7)]
    assert len(set(own[0])) == len(set(own[1])) == 1
    assert own[0][0] != own[1][0]


def test_what_hides_an_end_need_not_be_a_wall() -> None:
    bearing = np.deg2rad(np.arange(-30, 30, 0.5))
    reach = np.where(np.abs(bearing - 0.2) < 0.02, 1.5, 4 / np.cos(bearing))
    xy = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])
    _, labels = scan_walls(LaserScan(xy, 0.01))
    assert (labels[reach == 1.5] == -1).all()
    hidden = hidden_ends(LaserScan(xy), first_and_last(labels))
    np.testing.assert_array_equal(hidden, [[False, True], [True, False]])


def test_beams_are_known_by_their_even_bearings() -> None:
    rng = np.random.default_rng(12)
    bearing = np.deg2rad(np.arange(-60, 60, 0.5))
    reach = 4 / np.cos(bearing) + rng.normal(0, 0.05, len(bearing))
    beams = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])
    assert beam_angle(rng.permutation(beams[rng.random(len(beams)) < 0.7]))
    assert not beam_angle(on_wall(rng, wall(4, -3, 4, 3), 240, 0.05))
