"""Planes in space: a flight of stairs is treads and risers, not a slope."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.planes3d import refining
from relmap.planes3d.certainty import usual_steps
from relmap.planes3d.fitting import repeats
from relmap.planes3d.gathering import is_rough
from relmap.planes3d.hypothesis_kernels import best_ways
from relmap.planes3d.misled import is_led_away
from relmap.planes3d.refining import unsure_steps
from relmap.planes3d.sights import with_ends
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import PatchSegmenter
from relmap.simulation.storey import cast_rays
from tests.worlds import fed, refined

Side = tuple[float, float, float]
Face = tuple[Side, Side, Side]
STEPS, RISE_M, TREAD_M, WIDE_M = 7, 0.18, 0.3, 1.4
PATH = np.column_stack([np.linspace(-1.6, 0.4, 24), np.linspace(0.3, 1.1, 24), np.full(24, 2.0)])


def faces() -> tuple[Floats, Floats]:
    """Return the floor, three walls and a flight of stairs that leads along x: corners, sides."""
    found: list[Face] = [
        ((-3, 0, 0), (8, 0, 0), (0, 3, 0)),
        ((-3, 0, 0), (8, 0, 0), (0, 0, 3)),
        ((-3, 3, 0), (8, 0, 0), (0, 0, 3)),
        ((-3, 0, 0), (0, 3, 0), (0, 0, 3)),
    ]
    for k in range(STEPS):
        x, z = k * TREAD_M, k * RISE_M
        found.append(((x, 0, z), (0, WIDE_M, 0), (0, 0, RISE_M)))
        found.append(((x, 0, z + RISE_M), (TREAD_M, 0, 0), (0, WIDE_M, 0)))
    array = np.array(found, dtype=np.float64)
    return array[:, 0], array[:, 1:]


@pytest.fixture(scope="module")
def scans() -> list[Floats]:
    up, around = np.meshgrid(np.linspace(-0.9, 0.5, 32), np.linspace(-np.pi, np.pi, 240))
    level = np.cos(up)
    rays = np.stack([level * np.cos(around), level * np.sin(around), np.sin(up)], -1).reshape(-1, 3)
    rng, (origin, sides) = np.random.default_rng(0), faces()
    found = []
    for at in PATH:
        range_m, _ = cast_rays(at, rays, origin, sides)
        seen = range_m < 30.0
        noisy = range_m[seen] + 0.01 * rng.standard_normal(seen.sum())
        found.append(noisy[:, None] * rays[seen])
    return found


def camera_view(at: Floats) -> Floats:
    up, around = np.meshgrid(np.linspace(-0.9, 0.5, 200), np.linspace(-0.9, 0.9, 300))
    level = np.cos(up)
    rays = np.stack([level * np.cos(around), level * np.sin(around), np.sin(up)], -1).reshape(-1, 3)
    range_m, _ = cast_rays(at, rays, *faces())
    return np.asarray((range_m[:, None] * rays)[range_m < 30.0])


def test_stairs_are_mapped_as_treads(scans: list[Floats]) -> None:
    mapper = refined(Plane3dMapper(), scans)
    table = mapper.planes
    level = (table.status == "static") & (table.normal[:, 2] > 0.99)
    height_m = table.centre[level, 2] + PATH[0, 2]
    off_m = np.abs(height_m[:, None] - RISE_M * np.arange(1, STEPS + 1))
    assert off_m.min(axis=0).max() < 0.005
    for k in np.flatnonzero(level)[off_m.min(axis=1) < 0.005].tolist():
        assert np.ptp(table.outline[k][:, 0]) < 2 * TREAD_M
    slope = (np.abs(table.normal[:, 0]) > 0.3) & (np.abs(table.normal[:, 2]) > 0.3)
    assert not (slope & (table.status == "static")).any()


def test_points_of_a_slope_over_stairs_are_kept(scans: list[Floats]) -> None:
    found = PatchSegmenter()
    thick = 0
    for scan in scans:
        patches = found.fit(scan).patches_
        for k in np.flatnonzero(patches.spread[:, 2] > 0.03).tolist():
            own = scan[found.labels_ == k]
            assert np.isin(own[:, 0], patches.loose[:, 0]).sum() > 0.3 * len(own)
            thick += 1
    assert thick > 3


def test_a_slope_over_stairs_is_rough(scans: list[Floats]) -> None:
    mapper = fed(Plane3dMapper(), scans)
    (part,) = mapper.submaps
    planes = part.all_planes()
    assert is_rough(part).tolist() == (planes.spread[:, 2] > 0.03).tolist()
    (slope,) = planes.normal[is_rough(part)]
    assert slope[2] == pytest.approx(TREAD_M / np.hypot(TREAD_M, RISE_M), abs=0.05)


@pytest.mark.parametrize("rise", [-2, 0, 3])
def test_of_equal_motions_on_stairs_the_one_closest_to_the_prediction_is_first(rise: int) -> None:
    # Two walls, and two treads that match all others but for the ends of the flight.
    steps = range(-6, 7)
    of = np.array([0, 1, *[2] * len(steps), *[3] * len(steps)])
    normal = np.eye(3)[np.minimum(of, 2)]
    off = np.array([0.0, 0.0, *[RISE_M * k for k in steps] * 2])
    gate, weight, held = np.full(len(of), 0.01), np.full(4, 0.25), np.array([0, 0, RISE_M * rise])
    ways, support = best_ways(normal, off, of, gate, weight, held, 0.02)
    assert support.min() == 1.0
    np.testing.assert_allclose(ways[0], held, atol=1e-12)


@pytest.mark.parametrize("steps", [-1, 1])
def test_from_the_next_step_of_stairs_the_right_one_is_tried(steps: int) -> None:
    # All treads and risers match those of the next step, but for the ends of the flight.
    seen = PatchSegmenter().fit(camera_view(np.array([-1.6, 0.7, 1.5]))).patches_
    away = steps * np.array([TREAD_M, 0.0, RISE_M])
    ways = repeats(np.eye(3), away, seen, seen)
    assert min(np.linalg.norm(way) for way in ways) < 0.01


@pytest.mark.parametrize("steps", [-1, 0, 1])
def test_points_lead_away_from_a_step_off_by_a_tread(steps: int) -> None:
    # Steps of 0.09, 0.18 and 0.26 m in turn.
    path = PATH[[k for k in range(len(PATH)) if k % 6 in (0, 1, 3)]]
    part = Submap()
    for k, at in enumerate(path):
        seen = with_ends(PatchSegmenter().fit(camera_view(at)).patches_)
        place = at + (k >= 6) * steps * np.array([TREAD_M, 0.0, RISE_M])
        part.add(k, seen, (np.eye(3), place), np.arange(len(seen)))
    R, t = (np.array(each) for each in zip(*part.poses, strict=True))
    usual = usual_steps(R, t, np.array(part.iteration))
    led = [k for k in range(1, len(path)) if is_led_away(part, k, usual[k - 1][1:])]
    assert led == [6] * (steps != 0)


def test_a_step_that_points_lead_away_from_is_listed(
    scans: list[Floats], monkeypatch: pytest.MonkeyPatch
) -> None:
    (part,) = fed(Plane3dMapper(), scans).submaps
    assert not unsure_steps(part)
    monkeypatch.setattr(refining, "is_led_away", lambda part, k, usual: k == 7)
    assert list(unsure_steps(part)) == [7]
