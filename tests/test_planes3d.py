"""`Plane3dMapper`: scans placed by their planes alone, submaps, names, refinement."""

from __future__ import annotations

from operator import methodcaller
from typing import Any

import numpy as np
import pytest

from relmap import Plane3dMapper, RelmapError
from relmap.core.arrays import Floats
from relmap.planes3d.adjustment import PlaneAdjustment, Scene
from relmap.planes3d.files import COLUMNS
from relmap.planes3d.refining import sightings
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import RAGGED
from relmap.segmentation.space import PatchSegmenter
from relmap.simulation.storey import Storey, cast_rays, simulate_storey
from tests.worlds import ate_m, fed, finished

N = 12


def mapped(scans: list[Floats], refine: bool = False) -> Plane3dMapper:
    mapper = finished(Plane3dMapper(), scans)
    if refine:
        mapper.refine()
    return mapper


def from_first(poses: Floats) -> Floats:
    return np.linalg.inv(poses[0]) @ poses


@pytest.fixture(scope="module")
def noisy() -> tuple[Storey, Plane3dMapper]:
    world = simulate_storey("lidar", 0.02, N)
    return world, mapped(world.scans, refine=True)


def test_poses_without_noise_are_exact() -> None:
    world = simulate_storey("lidar", 0.0, N)
    mapper = mapped(world.scans)
    assert len(mapper.submaps) == 1
    assert not mapper.weak_links
    # A patch may hold points of another plane that lie on its own within rounding.
    assert np.abs(mapper.trajectory - from_first(world.trajectory)).max() < 1e-5
    mapper.refine()
    assert np.abs(mapper.trajectory - from_first(world.trajectory)).max() < 1e-9


def test_the_mapper_and_its_planes_print_their_content(noisy: tuple[Storey, Plane3dMapper]) -> None:
    mapper = noisy[1]
    n = int(np.sum(mapper.planes.status == "static"))
    assert repr(mapper) == f"Plane3dMapper({N} iterations, {n} planes mapped)"
    assert repr(Plane3dMapper()) == "Plane3dMapper(0 iterations, 0 planes mapped)"
    assert len(mapper.planes) == len(mapper.planes.plane)
    columns = mapper.planes.columns()
    wanted = [name for name in COLUMNS if name not in RAGGED]
    assert list(columns)[: len(wanted)] == wanted
    assert list(columns)[len(wanted)] == "c_nx_nx"
    assert list(columns)[-1] == "c_offset_offset"
    np.testing.assert_array_equal(columns["nz"], mapper.planes.normal[:, 2])
    html = methodcaller("_repr_html_")(mapper)
    assert f"<p>{mapper!r}</p>" in html
    assert html.count("<tr>") == 1 + min(10, len(mapper.planes))


def test_poses_are_as_good_as_plane_adjustment_with_true_associations(
    noisy: tuple[Storey, Plane3dMapper],
) -> None:
    world, mapper = noisy
    truth = from_first(world.trajectory)
    part, segmenter = Submap(), PatchSegmenter()
    for k, scan in enumerate(world.scans):
        seen = segmenter.fit(scan).patches_
        plane = world.plane_of[world.faces[k]]
        # A board has two sides, which are two planes of the mapper's; they are one of the truth's.
        true = [np.bincount(plane[segmenter.labels_ == p]).argmax() for p in range(len(seen))]
        part.add(k, seen, (truth[k, :3, :3], truth[k, :3, 3]), np.array(true))
    planes = part.all_planes()
    begin = Scene(
        truth[:, :3, :3], truth[:, :3, 3], planes.normal, planes.centre, np.zeros(len(part))
    )
    best = PlaneAdjustment(sightings(part)).solve(begin)
    poses = truth.copy()
    poses[:, :3, :3], poses[:, :3, 3] = best.R, best.t
    limit_m = ate_m(poses, truth, planar=False)
    assert 0 < limit_m < 0.003
    assert ate_m(mapper.trajectory, truth, planar=False) < 1.1 * limit_m


def test_planes_stand_once_where_they_are(noisy: tuple[Storey, Plane3dMapper]) -> None:
    world, mapper = noisy
    table = mapper.planes
    R, t = world.trajectory[0, :3, :3], world.trajectory[0, :3, 3]
    sides = world.corners[:, [1, 3]] - world.corners[:, :1]
    normal = np.cross(sides[:, 0], sides[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = (world.corners[:, 0] * normal).sum(axis=1)
    found = []
    for k in np.flatnonzero((table.status == "static") & (table.area_m2 > 1.0)):
        n, c = R @ table.normal[k], R @ table.centre[k] + t
        on = np.abs(normal @ c - offset) < 0.02
        on &= np.abs(normal @ n) > np.cos(np.deg2rad(1.0))
        assert on.any()
        found.append((world.plane_of[on.argmax()], bool(n @ normal[on.argmax()] > 0)))
    assert len(found) >= 8
    assert len(set(found)) == len(found)
    floor = int(np.argmax(table.area_m2))
    assert len(table.outline[floor]) > 10
    assert np.abs(table.outline[floor] @ table.normal[floor] - table.offset[floor]).max() < 1e-9


def test_standard_deviations_are_known_after_refinement(
    noisy: tuple[Storey, Plane3dMapper],
) -> None:
    world, mapper = noisy
    table = mapper.planes
    seen = table.observations > N // 2
    assert (table.sd_centre[seen] > 0).all()
    assert (table.sd_centre[seen] < 0.01).all()
    assert (table.sd_normal[seen] < 0.01).all()
    lever = np.insert(-table.centre, 3, 1.0, axis=1)
    across = np.einsum("ni,nij,nj->n", lever, table.covariance, lever)
    np.testing.assert_allclose(across, table.sd_centre**2)
    before = mapped(world.scans[:3]).planes
    assert np.isnan(before.sd_centre).all()
    assert np.isnan(before.covariance).all()


def test_runs_again_to_the_last_bit(noisy: tuple[Storey, Plane3dMapper]) -> None:
    world, mapper = noisy
    again = mapped(world.scans, refine=True)
    assert np.array_equal(again.trajectory, mapper.trajectory)
    assert np.array_equal(again.planes.offset, mapper.planes.offset)


def hall(x: float, yaw: float = 0.0, ends: bool = False) -> Floats:
    """Return a noisy scan of a corridor along x, from one place in it."""
    origin = [[-40.0, -1.5, 0.0], [-40.0, 1.5, 0.0], [-40.0, -1.5, 0.0]]
    sides = [[[80.0, 0, 0], [0, 0, 3.0]], [[80.0, 0, 0], [0, 0, 3.0]], [[80.0, 0, 0], [0, 3.0, 0]]]
    if ends:
        origin.append([4.0, -1.5, 0.0])
        sides.append([[0, 3.0, 0], [0, 0, 3.0]])
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 180), np.linspace(-0.7, 0.4, 30))
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    start = np.array([x, 0.2, 1.4])
    range_m, _ = cast_rays(start, rays @ R.T, np.array(origin), np.array(sides))
    seen = range_m < 15
    noise = 0.003 * np.random.default_rng(int(1000 * x)).standard_normal(seen.sum())
    return np.asarray(rays[seen] * (range_m[seen] + noise)[:, None])


def test_a_stretch_of_two_directions_is_named_and_its_free_direction() -> None:
    mapper = mapped([hall(0.2 * k, 0.05 * k) for k in range(8)], refine=True)
    assert len(mapper.submaps) == 1
    assert sorted(mapper.weak_links) == list(range(1, 8))
    for k, free in mapper.weak_links.items():
        along = [np.cos(0.05 * k), -np.sin(0.05 * k), 0]
        assert abs(free @ along) > 0.999
    # The motion along it is unobservable: it is assumed to stand, and the rest is unchanged.
    assert np.abs(mapper.trajectory[:, :3, 3]).max() < 0.02
    yaw = np.arctan2(mapper.trajectory[:, 1, 0], mapper.trajectory[:, 0, 0])
    assert np.abs(yaw - 0.05 * np.arange(8)).max() < 0.002


def test_a_wall_at_the_end_ties_the_free_direction() -> None:
    mapper = mapped([hall(0.2 * k, ends=True) for k in range(8)])
    assert not mapper.weak_links
    assert np.abs(mapper.trajectory[:, 0, 3] - 0.2 * np.arange(8)).max() < 0.01


def test_a_scan_without_known_planes_begins_a_submap_that_is_tied_later() -> None:
    world = simulate_storey("lidar", 0.005, 18)
    elsewhere = [np.random.default_rng(4).uniform(-3, 3, (3000, 3)) for _ in range(2)]
    tilted = simulate_storey("lidar", 0.005, 2, seed=1).scans
    other = [scan @ np.diag([1.0, 0.4, 2.2]) for scan in tilted]
    mapper = fed(Plane3dMapper(), [*world.scans[:6], *elsewhere, *other, *world.scans[6:12]])
    before = len(mapper.submaps)
    assert before >= 3
    mapper.refine()
    states = [mapper.is_refined]
    mapper.finish()
    assert [*states, mapper.is_refined] == [True, False]
    assert len(mapper.submaps) < before
    poses, known = mapper.trajectory, np.r_[:6, 10:16]
    assert np.abs(poses[known] - from_first(world.trajectory)[:12]).max() < 0.02
    assert np.isnan(poses[6:10]).all()
    # The next scan goes on with what was tied.
    mapper.update(world.scans[12])
    assert np.abs(mapper.trajectory[16] - from_first(world.trajectory)[12]).max() < 0.02


def test_a_plane_that_is_new_after_refinement_is_no_other_one() -> None:
    # Refinement joined the last plane that it found in the points of all scans to another.
    world = simulate_storey("lidar", 0.02, 5)
    mapper = mapped(world.scans[:4], refine=True)
    labels = mapper.update(world.scans[4])
    assert labels.max() == mapper.planes.plane.max()
    np.testing.assert_array_equal(mapper.landmarks_of(labels), labels)


def test_labels_of_joined_planes_lead_to_those_that_are_left() -> None:
    world = simulate_storey("lidar", 0.02, 8)
    mapper = Plane3dMapper()
    labels = np.concatenate([mapper.update(scan) for scan in world.scans])
    mapper.finish()
    mapper.refine()
    found = mapper.planes.plane
    # Planes that only all scans together show have larger numbers.
    known = found[found <= labels.max()].tolist()
    assert set(mapper.landmarks_of(labels).tolist()) == set(known)
    with pytest.raises(RelmapError):
        mapper.landmarks_of([10**6])


def test_scans_without_planes_have_no_pose() -> None:
    mapper = Plane3dMapper()
    assert mapper.update(np.empty((0, 3))).tolist() == []
    mapper.finish()
    mapper.refine()
    assert np.isnan(mapper.trajectory).all()
    assert mapper.submaps == []
    assert len(mapper.planes.plane) == 0


def test_a_scan_that_cannot_be_used_leaves_the_mapper_as_it_was() -> None:
    mapper = Plane3dMapper()
    mapper.update(simulate_storey("lidar", 0.0, 1).scans[0])
    with pytest.raises(RelmapError):
        mapper.update(np.full((100, 3), np.inf))
    assert mapper.n_iterations == 1


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(RelmapError, match="max_missed is 0"):
        Plane3dMapper(max_missed=0)
    settings: list[dict[str, Any]] = [{"voxel_m": 0.0}, {"min_points": 2}, {"most": 0}]
    for setting in settings:
        with pytest.raises(RelmapError, match=next(iter(setting))):
            PatchSegmenter(**setting)
    worlds: list[dict[str, Any]] = [{"sensor": "sonar"}, {"sigma": -1.0}, {"iterations": 0}]
    for world in worlds:
        with pytest.raises(RelmapError):
            simulate_storey(**world)


def test_a_depth_camera_is_mapped_in_one_piece() -> None:
    world = simulate_storey("depth", 0.005, 60)
    mapper = mapped(world.scans[:14])
    assert len(mapper.submaps) == 1
    assert np.abs(mapper.trajectory - from_first(world.trajectory[:14])).max() < 0.05


def test_a_leap_in_two_directions_only_is_rejected() -> None:
    scans = [hall(0.2 * k) for k in range(4)]
    elsewhere = hall(0.0) @ np.diag([1.0, 1.0, 1.0]) + [0.0, 0.0, 12.0]
    mapper = mapped([*scans, elsewhere])
    assert len(mapper.submaps) == 2


def test_standing_still_takes_no_more_cells() -> None:
    scan = simulate_storey("lidar", 0.0, 1).scans[0]
    mapper = mapped([scan] * 4)
    part = mapper.submaps[0]
    counts = [len(part.seen[k].cells) for k in range(4)]
    assert counts[0] > 300
    # A few on the border of two squares.
    assert sum(counts[1:]) < 0.1 * counts[0]


def test_half_a_turn_in_the_next_room_is_not_accepted() -> None:
    world = simulate_storey("lidar", 0.01, 8)
    mapper = mapped(world.scans)
    assert min(len(part.iteration) for part in mapper.submaps) > 1
    assert len(np.concatenate([part.iteration for part in mapper.submaps])) == 8
    for part in mapper.submaps:
        truth = from_first(world.trajectory[part.iteration])
        assert np.abs(part.trajectory - part.trajectory[0] @ truth).max() < 0.02


def test_noise_of_a_depth_camera_leaves_its_walls_whole() -> None:
    world = simulate_storey("depth", 0.02, 1)
    segmenter = PatchSegmenter().fit(world.scans[0])
    plane = world.plane_of[world.faces[0]]
    large = np.flatnonzero(np.bincount(plane) > 2500)
    assert len(large) > 2
    for wall in large:
        labels = segmenter.labels_[plane == wall]
        assert np.bincount(labels + 1)[1:].max() > 0.85 * len(labels)
