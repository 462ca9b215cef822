"""Plane adjustment: derivatives, and the least-squares solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.planes3d.adjustment import PlaneAdjustment, Scene, Sightings, across

SPREAD = np.array([1.0, 0.5, 0.01])


def room(seed: int = 0, sigma: float = 0.0) -> tuple[Sightings, Scene]:
    """Return observations of seven planes in six scans, with noise, and the true scene."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((7, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    base, off = -3 * normal + rng.uniform(-0.2, 0.2, (7, 3)), np.zeros(7)
    R = Rotation.from_rotvec(0.3 * rng.standard_normal((6, 3))).as_matrix()
    t = 0.4 * rng.standard_normal((6, 3))
    R[0], t[0] = np.eye(3), 0.0
    scan, plane = np.repeat(np.arange(6), 7), np.tile(np.arange(7), 6)
    n = normal[plane] + 0.2 * sigma * rng.standard_normal((42, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    e, f = across(n)
    shift = rng.uniform(-0.5, 0.5, (42, 2)) @ np.eye(2)
    here = base[plane] + shift[:, :1] * e + shift[:, 1:] * f
    here += 0.1 * sigma * rng.standard_normal((42, 1)) * n
    back = R[scan].transpose(0, 2, 1)
    axes = np.einsum("nij,nkj->nki", back, np.stack([e, f, n], axis=1))
    centre = np.einsum("nij,nj->ni", back, here - t[scan])
    information = np.tile(
        [25 / max(sigma, 0.01) ** 2, 25 / max(sigma, 0.01) ** 2, 100 / max(sigma, 0.01) ** 2],
        (42, 1),
    )
    seen = Sightings(scan, plane, centre, axes, information, np.tile(SPREAD, (42, 1)))
    return seen, Scene(R, t, normal, base, off)


def shaken(scene: Scene) -> Scene:
    rng = np.random.default_rng(3)
    turn = 0.05 * rng.standard_normal((len(scene.R), 3))
    way = 0.1 * rng.standard_normal((len(scene.R), 3))
    turn[0] = way[0] = 0.0
    e, f = across(scene.normal)
    normal = scene.normal + 0.05 * e - 0.03 * f
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    R = Rotation.from_rotvec(turn).as_matrix() @ scene.R
    return replace(scene, R=R, t=scene.t + way, normal=normal, off=scene.off + 0.05)


def test_exact_sightings_give_the_exact_scene() -> None:
    seen, truth = room()
    found = PlaneAdjustment(seen).solve(shaken(truth))
    assert np.abs(found.R - truth.R).max() < 1e-10
    assert np.abs(found.t - truth.t).max() < 1e-10
    assert np.abs(found.normal - truth.normal).max() < 1e-10


def test_a_step_goes_down_the_derivatives() -> None:
    """The right side of the equations is half the gradient of the squares, by differences."""
    seen, truth = room(sigma=0.02)
    problem, state = PlaneAdjustment(seen), shaken(truth)
    weight = np.ones(3 * len(seen.scan))
    # With poses eliminated the gradient is that of the least squares over all poses but the first.
    equations = problem.equations(state, weight, True, 0.0)
    factor = equations.matrix
    problem.pattern.factorise(factor)
    step = problem.pattern.solve(factor, equations.right)
    after = problem.stepped(state, equations, step, weight)
    before = (problem.residuals(state) ** 2).sum()
    assert (problem.residuals(after) ** 2).sum() < 0.02 * before
    settled = problem.solve(state)
    again = problem.equations(settled, problem.weights(problem.residuals(settled)), True, 0.0)
    assert np.abs(again.right).max() < 1e-3 * np.abs(equations.right).max()


def test_an_outlier_does_not_bend_the_map() -> None:
    seen, truth = room(sigma=0.01)
    clean = PlaneAdjustment(seen).solve(truth)
    centre = seen.centre.copy()
    centre[20] += 1.5 * seen.axes[20, 2]
    bent = PlaneAdjustment(replace(seen, centre=centre)).solve(truth)
    assert np.abs(bent.t - clean.t).max() < 0.02
    assert np.abs(bent.t[2] - clean.t[2]).max() > 0.0


def test_common_errors_are_estimated_from_the_residuals() -> None:
    seen, truth = room(seed=2, sigma=0.01)
    exact = replace(seen, information=1e4 * seen.information)
    for each, least, most in ((exact, 0.03, np.inf), (seen, 0.0, 0.5)):
        problem = PlaneAdjustment(each)
        assert least <= problem.systematic_share(problem.solve(truth)) < most


def test_a_free_direction_stays_where_it_was() -> None:
    """Three parallel planes do not determine the motion along them."""
    seen, truth = room()
    alike = np.isin(seen.scan, [4]) & (seen.plane > 0)
    few = replace(
        seen,
        **{name: getattr(seen, name)[~alike] for name in ("scan", "plane", "centre", "axes")},
        information=seen.information[~alike],
        spread=seen.spread[~alike],
    )
    free = truth.R[4].T @ across(truth.normal[:1])[0][0]
    found = PlaneAdjustment(few, free={4: free[None]}).solve(truth)
    assert np.abs(found.t[4] - truth.t[4]).max() < 1e-6
