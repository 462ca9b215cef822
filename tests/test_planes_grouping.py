"""The role of groups in a map of walls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.mapper import RelativeMapper
from relmap.simulation import simulate_building
from tests.worlds import refined


def after_a_building() -> PlaneMapper:
    building = simulate_building(points=10, sigma=0.0, seed=0)
    return refined(PlaneMapper(), (scan.seen for scan in building.scans))


def test_without_groups_no_wall_is_mapped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion from scan to scan bridges what groups placed; by itself it maps nothing."""
    monkeypatch.setattr(RelativeMapper, "relative_map", lambda *_: None)
    mapper = after_a_building()
    assert len(mapper.history.iteration) > 1000
    assert len(mapper.map.positions) == 0
    assert not (mapper.planes.status == "static").any()
    assert mapper.refined == []


def test_where_only_the_first_scans_are_grouped_the_map_still_begins_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A scan that no group placed is bridged to by the motion, as along a wall without corners."""
    group = RelativeMapper.group

    def early(engine: RelativeMapper, seed: int, level: int) -> Any:
        late = engine.store.n_iterations > 30
        return np.empty(0, dtype=np.int64) if late else group(engine, seed, level)

    monkeypatch.setattr(RelativeMapper, "group", early)
    mapper = after_a_building()
    assert np.isfinite(mapper.trajectory).all()
    assert len(mapper.map.positions) > 10


def test_walls_that_the_groups_merged_stay_one_where_refining_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    building = simulate_building(points=10, sigma=0.0, seed=0, loops=2)
    mapper = PlaneMapper()
    labels = np.unique(np.concatenate([mapper.update(scan.seen) for scan in building.scans]))
    mapper.finish()
    merged = mapper.landmarks_of(labels)
    assert (merged != labels).sum() > 10
    monkeypatch.setattr(
        "relmap.planes.refinement.refining.refined_map",
        lambda _, numbers, submap, *__: (submap, numbers),
    )
    mapper.refine()
    now = mapper.landmarks_of(labels)
    np.testing.assert_array_equal(now, mapper.landmarks_of(merged))


def test_a_stretch_too_short_for_a_group_on_the_way_is_mapped_at_the_end() -> None:
    mapper, room = PlaneMapper(), np.array([[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]]])
    nothing = SimpleNamespace(ends=np.empty((0, 2, 2)))
    kind = np.full((2, 2), "corner")
    for k in range(50):
        seen = SimpleNamespace(ends=room - [0.1 * k - 3.0, 0.0], end_type=kind)
        mapper.update(nothing if 7 <= k < 20 else seen)
    mapper.finish()
    mapper.refine()
    short = next(submap for submap in mapper.submaps if submap.first_iteration == 0)
    assert len(short.landmark_ids) == 4
    np.testing.assert_allclose(np.ptp(short.positions, axis=0), [6.0, 6.0, 0.0], atol=1e-6)
