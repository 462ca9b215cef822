"""Planes in space: a plane through a ceiling and the beams below it does not tilt the path."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.planes3d.placing import apart
from relmap.simulation.storey import cast_rays
from tests.worlds import fed

WIDE_M, DEEP_M, HIGH_M = 24.0, 15.0, 2.3


def faces() -> tuple[Floats, Floats]:
    """Return the faces of a low garage with beams, pillars and cars: corners, sides."""
    found: list[tuple[Floats, Floats, Floats]] = []

    def box(low: list[float], high: list[float]) -> None:
        for axis, end in itertools.product(range(3), (low, high)):
            corner, size = np.array(low), np.diag(np.subtract(high, low))
            corner[axis] = end[axis]
            found.append((corner, size[(axis + 1) % 3], size[(axis + 2) % 3]))

    box([0.0, 0.0, 0.0], [WIDE_M, DEEP_M, HIGH_M])
    for x in (4.0, 9.0, 14.0, 19.0):
        box([x, 0.0, 2.0], [x + 0.3, DEEP_M, HIGH_M])
    for x, y in itertools.product((4.15, 9.15, 14.15), (5.0, 10.0)):
        box([x - 0.2, y - 0.25, 0.0], [x + 0.2, y + 0.25, HIGH_M])
    for x, y in itertools.product((1.4, 6.5, 11.5, 16.5), (1.0, 11.0)):
        box([x - 0.9, y, 0.25], [x + 0.9, y + 4.2, 0.95])
    array = np.array(found)
    return array[:, 0], array[:, 1:]


@pytest.mark.parametrize("seed", [2, 35])
def test_a_plane_through_beams_does_not_tilt_the_path(seed: int) -> None:
    # The fit to it explains nearly as much of a scan as that to the ceiling.
    up, around = np.meshgrid(
        np.deg2rad(np.linspace(-15, 15, 16)), np.linspace(-np.pi, np.pi, 900, endpoint=False)
    )
    level = np.cos(up)
    rays = np.stack([level * np.cos(around), level * np.sin(around), np.sin(up)], -1).reshape(-1, 3)
    rng, poses, scans, x = np.random.default_rng(seed), [], [], 2.0
    for _ in range(5):
        x += rng.uniform(0.2, 0.7)
        angles = np.deg2rad([rng.uniform(-20, 20), *rng.uniform(-10, 10, 2)])
        R, at = Rotation.from_euler("ZYX", angles).as_matrix(), np.array([x, 7.5, 1.6])
        range_m, _ = cast_rays(at, rays @ R.T, *faces())
        range_m += 0.02 * rng.standard_normal(len(rays))
        scans.append((range_m[:, None] * rays)[rng.random(len(rays)) > 0.1])
        poses.append((R, at))
    (part,) = fed(Plane3dMapper(), scans).submaps
    first, origin = poses[0]
    for (R, t), (S, at) in zip(part.poses, poses, strict=True):
        turn, way_m = apart(R, t, first.T @ S, first.T @ (at - origin))
        assert turn < np.deg2rad(0.2)
        assert way_m < 0.02
