"""Valid and impossible output of a segmenter: a rejected update changes nothing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper, RelmapError
from relmap.simulation import simulate_building
from tests.savedmaps import state

ROOM = np.array([[[3.0, -2.0], [3.0, 2.0]], [[3.0, 2.0], [-1.0, 2.0]]])
KIND = np.array([["view", "corner"], ["corner", "view"]])


def walls(**changed: Any) -> SimpleNamespace:
    seen = {"ends": ROOM, "end_type": KIND, "noise": [0.1, 0.1], "n_points": [9, 9]}
    return SimpleNamespace(**seen | {"z_extent": np.zeros((2, 2))} | changed)


@pytest.mark.parametrize(
    ("planes", "named"),
    [
        (walls(ends=np.where(ROOM == 2.0, np.nan, ROOM)), "wall 0 ends at"),
        (walls(ends=1e9 * ROOM), "wall 0 ends at"),
        (walls(ends=ROOM.reshape(2, 4)), "ends has shape"),
        (walls(ends=[["a"]]), "ends must be"),
        (walls(ends=ROOM[:, ::-1]), "wall 0 is seen from behind"),
        (walls(end_type=KIND[:1]), "end_type has shape"),
        (walls(noise=[0.1]), "noise has shape"),
        (walls(noise=[0.1, np.nan]), "noise holds"),
        (walls(noise=[0.1, -0.1]), "noise holds"),
        (walls(n_points=["many", 1]), "n_points must be"),
        (walls(z_extent=np.zeros(2)), "z_extent has shape"),
        (np.full((4, 3), np.nan), "points row 0 is"),
        (np.ones((4, 5)), "points has shape"),
        ("points", "points"),
    ],
)
def test_impossible_walls_change_nothing(planes: Any, named: str, tmp_path: Path) -> None:
    mapper = PlaneMapper()
    mapper.update(walls())
    before = state(mapper, tmp_path)
    with pytest.raises(RelmapError, match=named):
        mapper.update(planes)
    with pytest.raises(RelmapError, match="ids were given"):
        mapper.update(walls(), ids=[1, 2])
    assert state(mapper, tmp_path) == before


def test_walls_in_any_array_and_gaps_in_seeing_them() -> None:
    scans = [scan.seen for scan in simulate_building(seed=0, points=20, iterations=60).scans]
    plain, tried = PlaneMapper(), PlaneMapper()
    for k, scan in enumerate(scans):
        ends: Any = [scan.ends.tolist(), np.asfortranarray(scan.ends), scan.ends][k % 3]
        other = SimpleNamespace(ends=ends, end_type=scan.end_type.tolist())
        np.testing.assert_array_equal(tried.update(other), plain.update(scan))
    nothing = SimpleNamespace(ends=[], end_type=[])
    assert len(tried.update(nothing)) == 0
    for scan in scans[::-1]:
        tried.update(scan)
    tried.finish()
    tried.refine()
    assert len(tried.trajectory) == 121
