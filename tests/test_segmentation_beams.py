"""Walls that a grid of beams meets: noise lies along each beam, and bearings are exact."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneSegmenter
from relmap.segmentation.em.moves import missed_beams
from relmap.segmentation.em.step_kernels import fit_line
from relmap.segmentation.em.wall_kernels import sightings
from relmap.segmentation.ends.end_kernels import fit_ends
from relmap.segmentation.noise import beam_angle
from relmap.segmentation.wall import BEGIN, END
from relmap.simulation.building import building_scene

BEAM = np.deg2rad(1.5)
OBLIQUE = (np.array([4.0, 2.0]), np.array([0.96, 0.28]))
"""A point and the direction of a wall that beams meet at a flat angle."""


def grid(bearing: np.ndarray, rows: int, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Return the points of the oblique wall measured by columns of beams, (columns * rows, 2)."""
    (x, y), (ux, uy) = OBLIQUE
    reach = (x * uy - y * ux) / (np.cos(bearing) * uy - np.sin(bearing) * ux)
    reach = np.repeat(reach, rows) + rng.normal(0, sigma, rows * len(bearing))
    angle = np.repeat(bearing, rows)
    return np.array([reach * np.cos(angle), reach * np.sin(angle)]).T


def row(begin: float, end: float) -> np.ndarray:
    """Return the true wall between two places."""
    return np.array([*OBLIQUE[0], *OBLIQUE[1], begin, end, 1.0])


def columns(first: int, last: int) -> np.ndarray:
    """Return the bearings of some columns."""
    return np.asarray(BEAM * np.arange(first, last))


def test_noise_along_beams_does_not_turn_a_wall() -> None:
    """It moves points along an oblique wall too: total least squares turn it by a deviation."""
    rng = np.random.default_rng(0)
    turns = []
    for _ in range(200):
        wall = row(0, 1)
        fit_line(grid(columns(16, 26), 20, 0.1, rng), wall, BEAM)
        turns.append(np.arctan2(wall[3], wall[2]) - np.arctan2(0.28, 0.96))
    assert abs(np.mean(turns)) < 4 * np.std(turns) / np.sqrt(len(turns))
    assert np.std(turns) < np.deg2rad(1.5)


def test_a_point_shows_where_its_beam_meets_the_wall() -> None:
    rng = np.random.default_rng(1)
    exact = sightings(grid(columns(16, 26), 3, 0.0, rng), row(0, 1), BEAM)
    noisy = sightings(grid(columns(16, 26), 3, 0.3, rng), row(0, 1), BEAM)
    np.testing.assert_allclose(noisy[0], exact[0], atol=1e-12)
    np.testing.assert_allclose(noisy[1], exact[1], atol=1e-9)
    np.testing.assert_allclose(exact[2], 0, atol=1e-12)
    behind = sightings(np.array([[-1.0, -3.0]]), row(0, 1), BEAM)
    assert np.isinf(behind[2]).all()


@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_ends_lie_half_a_beam_beyond_the_last_one(sigma: float) -> None:
    rng = np.random.default_rng(2)
    xy = grid(columns(16, 26), 20, sigma, rng)
    half = grid(BEAM * np.array([15.5, 25.5]), 1, 0.0, rng)
    begin, end = np.sort(sightings(half, row(0, 1), BEAM)[1])
    wall = row(begin + 0.3, end - 0.3)
    fit_ends(xy, np.ones(len(xy)), wall, max(sigma, 1e-9), 0.0, BEAM)
    np.testing.assert_allclose(wall[[BEGIN, END]], [begin, end], atol=2e-3)


def test_one_missing_column_is_a_gap() -> None:
    bearing = np.repeat(np.delete(columns(0, 20), 8), 5)
    gap = missed_beams(bearing, BEAM)
    assert gap == pytest.approx((7.5 * BEAM, 8.5 * BEAM))
    assert missed_beams(columns(0, 20), BEAM) is None
    assert missed_beams(columns(0, 1), BEAM) is None


def test_the_angle_between_columns_is_found() -> None:
    xy = grid(np.delete(columns(16, 40), [3, 4, 11]), 10, 0.1, np.random.default_rng(3))
    assert beam_angle(xy) == pytest.approx(BEAM)


def test_a_single_column_is_not_a_wall() -> None:
    rng = np.random.default_rng(4)
    near = np.column_stack([np.full(30, 2.0), np.full(30, 2.0 * np.tan(20 * BEAM))])
    xyz = np.zeros((230, 3))
    xyz[:, :2] = np.vstack([grid(columns(22, 32), 20, 0.05, rng), near])
    segmenter = PlaneSegmenter().fit(xyz)
    assert len(segmenter.planes_) == 1
    assert (segmenter.labels_[200:] == -1).all()


def test_ends_in_ray_cast_scenes_are_not_biased() -> None:
    """Noise once made a wall reach through a door to what it met behind, by up to 4 m."""
    outward = []
    for seed in range(1000, 1030):
        scan = building_scene(seed, 2000, 0.1, sampling="rays")
        segmenter = PlaneSegmenter(view_rad=np.pi / 2, range_m=8.0).fit(scan.points)
        for ends, kind, stretch in zip(scan.seen.ends, scan.seen.end_type, range(99), strict=False):
            own = scan.stretch == stretch
            plane = np.bincount(segmenter.labels_[own] + 1, minlength=2)[1:].argmax()
            if own.sum() < 60 or (segmenter.labels_[own] == plane).mean() < 0.8:
                continue
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            for side in np.flatnonzero(kind == "corner"):
                off = (segmenter.planes_.ends[plane, side] - ends[side]) @ along
                outward.append(off * (2 * side - 1))
    assert len(outward) > 50
    assert abs(np.mean(outward)) < 0.03
    assert np.max(np.abs(outward)) < 1.0
