"""Registration by likelihood, where single matches are ambiguous."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.association.likelihood import CLEAR
from relmap.core.association.placement import Placement
from relmap.core.association.scale import spacing_of
from relmap.core.association.soft import SoftMatching, likely_links
from relmap.evaluation.surface_points import map_of, wall_points
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import purity_of, turn

FIELD_M = 24.0


def matching_of(here: np.ndarray, there: np.ndarray, sigma_m: float) -> SoftMatching:
    return SoftMatching(here, np.full(len(here), 2 * sigma_m**2), there, spacing_of(here), None)


@pytest.mark.parametrize("seed", range(3))
def test_a_scan_is_placed_though_its_single_matches_are_ambiguous(seed: int) -> None:
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(0, FIELD_M, (40, 2))
    sigma_m = 0.25 * spacing_of(landmarks)
    R, t = turn(0.7), np.array([3.0, -1.0])
    here = landmarks + rng.normal(0, sigma_m, landmarks.shape)
    there = landmarks @ R.T + t + rng.normal(0, sigma_m, landmarks.shape)
    matching = matching_of(here, rng.permutation(there), sigma_m)
    found = matching.found(*matching.by_triangles())
    placement, score, rival = found
    off = placement.apply(landmarks) - landmarks @ R.T - t
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < sigma_m
    assert score > 10
    assert rival < CLEAR * score


def test_a_shift_to_the_neighbours_is_a_rival() -> None:
    """Two rows of marks, of which the scan shows the middle."""
    rng = np.random.default_rng(3)
    rows = np.stack(np.meshgrid(np.arange(16.0), [-1.0, 1.0]), axis=-1).reshape(-1, 2)
    there = rows[np.abs(rows[:, 0] - 7.5) < 5] + rng.normal(0, 0.2, (20, 2))
    matching = matching_of(rows + rng.normal(0, 0.2, rows.shape), there, 0.2)
    start = Placement(np.eye(2), np.array([0.1, 0.0]), 20)
    found = matching.found(*matching.by_shifts(2.0, start))
    assert found[2] > CLEAR * found[1]


def test_unrelated_points_have_no_likely_placement() -> None:
    rng = np.random.default_rng(5)
    here, there = rng.uniform(0, FIELD_M, (2, 40, 2))
    matching = matching_of(here, there, 0.25 * spacing_of(here))
    found = matching.found(*matching.by_triangles())
    assert found is None or found[1] < 10


def test_a_lattice_has_rivals() -> None:
    rng = np.random.default_rng(6)
    lattice = np.stack(np.meshgrid(*2 * [np.arange(7.0)]), axis=-1).reshape(-1, 2)
    here, there = lattice + rng.normal(0, 0.1, (2, *lattice.shape))
    matching = matching_of(here, there, 0.1)
    found = matching.found(*matching.by_triangles())
    assert found[2] > CLEAR * found[1]


def test_the_noise_is_estimated_from_ambiguous_matches() -> None:
    rng = np.random.default_rng(7)
    landmarks = rng.uniform(0, 4 * FIELD_M, (600, 2))
    sigma_m = 0.15 * spacing_of(landmarks)
    here, there = landmarks + rng.normal(0, sigma_m, (2, *landmarks.shape))
    matching = matching_of(here, there, sigma_m)
    assert matching.misfit(Placement(np.eye(2), np.zeros(2), 0)) == pytest.approx(1, abs=0.15)


def test_links_are_the_likeliest_together() -> None:
    tracks = np.array([[0.0, 0.0], [1.0, 0.0]])
    points = np.array([[0.9, 0.0], [1.8, 0.0]])  # the first is nearest to the second track
    rows, found = likely_links(tracks, np.full(2, 0.25), np.array([9, 9]), points, None)
    assert dict(zip(rows.tolist(), found.tolist(), strict=True)) == {0: 0, 1: 1}


@pytest.mark.parametrize("n", [(0, 3), (3, 0)])
def test_nothing_is_linked_to_nothing(n: tuple[int, int]) -> None:
    expected, points = np.zeros((n[0], 2)), np.zeros((n[1], 2))
    rows, found = likely_links(expected, np.ones(n[0]), np.ones(n[0], np.int64), points, None)
    assert len(rows) == len(found) == 0


def test_a_world_of_much_noise_is_followed() -> None:
    spec = WorldSpec(kind="field", length_m=540.0, sigma=0.5, seed=11)
    world = simulate_world(spec)
    mapper, scans = PointMapper(), list(world.log.scans())[:36]
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in scans])
    ids = world.true_ids[: len(labels)]
    assert purity_of(labels, ids) > 0.88
    assert len(np.unique(labels)) < 3 * len(np.unique(ids))


@pytest.mark.parametrize(
    ("seed", "others"),
    [(41, {}), (43, {}), (45, {}), (10, {"sigma": 0.02, "turn_deg": 35.0, "view_deg": 180.0})],
)
def test_columns_on_a_lattice_are_not_taken_for_their_neighbours(
    seed: int, others: dict[str, float]
) -> None:
    """Steps of more than half a period, and a corner: a period or a turn away many agree too."""
    spec = WorldSpec(kind="columns", length_m=300.0, iterations=120, seed=seed)
    world = simulate_world(replace(spec, **others))  # type: ignore[arg-type]
    mapper, scans = PointMapper(), list(world.log.scans())[:25]
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in scans])
    ids = world.true_ids[: len(labels)]
    assert purity_of(labels, ids) > 0.99
    assert len(np.unique(labels)) < 2 * len(np.unique(ids))


def test_points_on_walls_do_not_slip_along_them() -> None:
    _, run = map_of("points", wall_points(0.3, 0.05, 0, 50))
    assert run.map_rmse_m < 0.02
    assert run.coverage > 0.95
