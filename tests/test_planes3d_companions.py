"""Planes in space: two companions with flat backs, ahead of a depth camera at its pace."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.simulation.storey import cast_rays
from tests.worlds import refined

STEP_M, SCANS, WIDE_M, HIGH_M, DOOR_M = 0.15, 12, 2.4, 2.6, 0.9


def corridor() -> Floats:
    """Return a corridor with doors that are 0.3 m deep, (f, 3, 3): corners and sides."""
    found = [
        [(-2, 0, 0), (22, 0, 0), (0, WIDE_M, 0)],
        [(-2, 0, HIGH_M), (22, 0, 0), (0, WIDE_M, 0)],
        [(20, 0, 0), (0, WIDE_M, 0), (0, 0, HIGH_M)],
    ]
    for y, out in ((0.0, -0.3), (WIDE_M, 0.3)):
        for x in np.arange(-2.0 + 1.3 * (out > 0), 20.0, 3.1):
            found += [
                [(x, y, 0), (3.1 - DOOR_M, 0, 0), (0, 0, HIGH_M)],
                [(x + 3.1 - DOOR_M, y + out, 0), (DOOR_M, 0, 0), (0, 0, HIGH_M)],
                [(x + 3.1 - DOOR_M, y, 0), (0, out, 0), (0, 0, HIGH_M)],
                [(x + 3.1, y, 0), (0, out, 0), (0, 0, HIGH_M)],
            ]
    return np.array(found, dtype=np.float64)


def scans_behind(companions: Floats) -> list[Floats]:
    """Return the scans of a depth camera; `companions` (c, 2): places ahead of it at the start."""
    up, around = np.meshgrid(np.linspace(-0.5, 0.5, 160), np.linspace(-0.6, 0.6, 200))
    rays = np.stack([np.ones_like(up), np.tan(around), np.tan(up)], -1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    rng, scans = np.random.default_rng(0), []
    for k in range(SCANS):
        at = np.array([STEP_M * k, 1.2, 1.4])
        backs = [[(x + at[0], y, 0), (0, 0.5, 0), (0, 0, 1.75)] for x, y in companions]
        faces = np.concatenate([corridor(), np.reshape(backs, (-1, 3, 3))])
        range_m, _ = cast_rays(at, rays, faces[:, 0], faces[:, 1:])
        seen = range_m < 8.0
        noise_m = 0.005 * (range_m[seen] * rays[seen, 0] / 2) ** 2 * rng.standard_normal(seen.sum())
        scans.append((range_m[seen] + noise_m)[:, None] * rays[seen])
    return scans


@pytest.mark.parametrize("companions", [[[1.6, 0.4], [2.2, 1.5]], []])
def test_wrong_steps_behind_companions_are_listed(companions: list[list[float]]) -> None:
    mapper = refined(Plane3dMapper(), scans_behind(np.reshape(companions, (-1, 2))))
    length_m = np.linalg.norm(np.diff(mapper.trajectory[:, :3, 3], axis=0), axis=1)
    wrong = 1 + np.flatnonzero(np.abs(length_m - STEP_M) > 0.1)
    # Behind companions the camera seems to stand still, for as long as there is one map.
    assert len(wrong) >= SCANS - 3 if companions else not len(wrong)
    listed = set(mapper.weak_links)
    assert set(wrong.tolist()) <= listed if companions else not listed
