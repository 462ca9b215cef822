"""Planes in space: how well planes and steps are known, and landmarks that are one surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.planes3d.adjustment import PlaneAdjustment, Scene, across
from relmap.planes3d.certainty import plane_covariances, step_covariances
from relmap.planes3d.refining import refined, unsure_steps
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import Patches, PatchSegmenter
from tests.test_plane_adjustment import room

DELTA = 1e-6


def stepped(scene: Scene, change: Floats) -> Scene:
    """Return a scene after a small change of all poses but the first, and of all planes."""
    p = len(scene.R)
    poses = np.concatenate([np.zeros((1, 6)), change[: 6 * (p - 1)].reshape(-1, 6)])
    planes = change[6 * (p - 1) :].reshape(-1, 3)
    e, f = across(scene.normal)
    normal = scene.normal + planes[:, :1] * e + planes[:, 1:2] * f
    return replace(
        scene,
        R=Rotation.from_rotvec(poses[:, :3]).as_matrix() @ scene.R,
        t=scene.t + poses[:, 3:],
        normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        off=scene.off + planes[:, 2],
    )


def test_covariances_are_those_of_the_whole_least_squares() -> None:
    seen, truth = room()
    problem = PlaneAdjustment(seen)
    count = 6 * (len(truth.R) - 1) + 3 * len(truth.normal)
    ways = [stepped(truth, row) for row in DELTA * np.eye(count)]
    still = problem.residuals(truth)
    J = np.column_stack([(problem.residuals(each) - still) / DELTA for each in ways])
    whole = np.linalg.inv(J.T @ J)

    def step(scene: Scene, k: int) -> Floats:
        turned = scene.R[k].T @ scene.R[k + 1] @ truth.R[k + 1].T @ truth.R[k]
        way = scene.R[k].T @ (scene.t[k + 1] - scene.t[k])
        return np.append(Rotation.from_matrix(turned).as_rotvec(), way)

    found = step_covariances(seen, truth, 0.0)
    assert found.shape == (len(truth.R) - 1, 6, 6)
    for k in range(len(found)):
        by = np.column_stack([(step(each, k) - step(truth, k)) / DELTA for each in ways])
        back = np.kron(np.eye(2), truth.R[k + 1].T @ truth.R[k])
        expected = back @ by @ whole @ by.T @ back.T
        scale = np.sqrt(np.outer(*[np.diag(expected)] * 2))
        assert np.abs(found[k] - expected).max() < 1e-3 * scale.max()
        assert np.abs(found[k] - expected)[:3, :3].max() < 1e-3 * scale[:3, :3].max()

    def plane(scene: Scene, k: int) -> Floats:
        return np.append(scene.normal[k], scene.normal[k] @ scene.base[k] + scene.off[k])

    planes = plane_covariances(seen, truth, 0.0)
    assert planes.shape == (len(truth.normal), 4, 4)
    for k in range(len(planes)):
        by = np.column_stack([(plane(each, k) - plane(truth, k)) / DELTA for each in ways])
        expected = by @ whole @ by.T
        assert np.abs(planes[k] - expected).max() < 1e-3 * np.abs(expected).max()


def test_planes_without_a_direction_have_no_standard_deviation() -> None:
    seen = patches(*[wall(axis, 3.0) for axis in range(3)], wall(0, 2.0, (-0.5, 0.5)))
    strip = seen.information.copy()
    strip[3, :2] = 0.0
    mapper = Plane3dMapper()
    mapper.update(replace(seen, information=strip))
    mapper.refine()
    assert np.isfinite(mapper.planes.sd_normal).tolist() == [True, True, True, False]
    assert np.isfinite(mapper.planes.sd_centre).tolist() == [True, True, True, False]
    strip[3, 2] = 0.0
    with pytest.raises(RelmapError, match="must be above 0 for the distance"):
        mapper.update(replace(seen, information=strip))


def test_errors_of_planes_are_as_large_as_their_covariances_say() -> None:
    squares, rng = [], np.random.default_rng(0)
    for seed in range(60):
        exact, truth = room(seed)
        tilt, off = rng.standard_normal((2, len(exact.scan), 3)) / np.sqrt(exact.information)
        tilt[:, 2] = 0.0
        turn = Rotation.from_rotvec(np.einsum("ni,nij->nj", tilt, exact.axes)).as_matrix()
        seen = replace(
            exact,
            axes=np.einsum("nij,nkj->nki", turn, exact.axes),
            centre=exact.centre + off[:, 2:] * exact.axes[:, 2],
        )
        found = PlaneAdjustment(seen).solve(truth)
        covariance = plane_covariances(seen, found, 0.0)
        reach = (found.normal * found.base).sum(1) + found.off - (truth.normal * truth.base).sum(1)
        error = np.column_stack([found.normal - truth.normal, reach])
        # The length of the normal is known: three degrees of freedom.
        information = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
        squares.append(np.einsum("ni,nij,nj->n", error, information, error))
    assert np.mean(squares) == pytest.approx(3.0, rel=0.15)


def test_planes_known_in_some_directions_only_do_no_harm() -> None:
    seen, truth = room()
    alone, rng = step_covariances(seen, truth, 0.0), np.random.default_rng(0)
    least = 1e-6 * np.trace(alone, axis1=1, axis2=2)[:, None]
    for _ in range(200):
        # Long and thin, near or far, and seen once.
        one = {name: getattr(seen, name)[:1] for name in ("scan", "axes", "spread")}
        one["information"] = seen.information[:1] * 10 ** rng.uniform(-12, 12, 3)
        one["centre"] = seen.centre[:1] * 10 ** rng.uniform(0, 3)
        one["plane"] = np.array([len(truth.normal)])
        both = {name: np.concatenate([one[name], getattr(seen, name)]) for name in one}
        planes = {
            name: np.concatenate([getattr(truth, name), getattr(truth, name)[:1]])
            for name in ("normal", "base", "off")
        }
        found = step_covariances(replace(seen, **both), replace(truth, **planes), 0.0)
        assert (np.linalg.eigvalsh(alone - found) > -least).all()
        assert (np.linalg.eigvalsh(found) > 0).all()


def wall(axis: int, at: float, span: tuple[float, float] = (-2.0, 2.0)) -> Floats:
    """Return points (n, 3) of a wall across an axis; `span` is where along the next axis."""
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(*span, 60), np.linspace(-1.0, 1.0, 30)))
    off = 0.003 * np.random.default_rng(axis).standard_normal(len(u))
    return np.roll(np.column_stack([at + off, u, v]), axis, axis=1)


def patches(*walls: Floats) -> Patches:
    segmenter = PatchSegmenter().fit(np.concatenate(walls))
    found = segmenter.patches_
    assert len(found) == len(walls)
    # In the order in which the walls are given.
    first = np.cumsum([0, *map(len, walls)])[:-1] + 900
    order = segmenter.labels_[first]
    rank = np.argsort(order)[found.cell_patch]
    by_rank = np.argsort(rank, kind="stable")
    return replace(
        found,
        **{
            name: getattr(found, name)[order]
            for name in ("centre", "axes", "information", "spread", "n_points")
        },
        cells=found.cells[by_rank],
        cell_patch=rank[by_rank],
    )


def part_of(*scans: tuple[Patches, list[int]]) -> Submap:
    part = Submap()
    for k, (seen, number) in enumerate(scans):
        part.add(k, seen, (np.eye(3), np.zeros(3)), np.array(number))
    return part


def test_a_step_that_planes_of_two_directions_determine_is_unsure() -> None:
    corner = patches(wall(0, 3.0), wall(1, 3.0), wall(2, 3.0))
    corridor = patches(wall(0, 3.0), wall(1, 3.0))
    whole, two = (corner, [0, 1, 2]), (corridor, [0, 1])
    assert unsure_steps(part_of(whole, whole, whole)) == {}
    found = unsure_steps(part_of(whole, whole, two, whole, whole))
    assert sorted(found) == [2, 3]
    assert np.abs(found[2]) == pytest.approx([0.0, 0.0, 1.0], abs=0.01)


@pytest.mark.parametrize(("span", "joined"), [((-2.0, 2.0), True), ((2.2, 5.0), False)])
def test_landmarks_that_cover_the_same_surface_are_joined(
    span: tuple[float, float], joined: bool
) -> None:
    sides = wall(1, 4.0), wall(2, 3.0)
    here, there = patches(wall(0, 3.0), *sides), patches(wall(0, 3.014, span), *sides)
    part, name = refined(part_of((here, [0, 1, 2]), (there, [9, 1, 2])), 10)
    assert name == ({9: 0} if joined else {})
    assert len(part) == (3 if joined else 4)
