"""Refined steps that beams contradict are held to the links between the scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.motions import inverse, matrices
from relmap.planes.submaps.contradicted import contradicted_steps
from relmap.simulation import simulate_building

BENT = 20


@pytest.fixture(scope="module")
def refined() -> PlaneMapper:
    """Return the refined map of a simulated laser; do not change it."""
    building = simulate_building(
        points=361, sigma=0.01, sampling="laser", iterations=40, step_m=0.5
    )
    mapper = PlaneMapper()
    for scan in building.scans:
        mapper.update(scan.points[:, :2])
    mapper.finish()
    mapper.refine()
    return mapper


def links_of(mapper: PlaneMapper) -> LinkRecord:
    """Return the links between the scans of a mapper."""
    return mapper.engine.association.registration.links  # type: ignore[union-attr, no-any-return]


def bent(poses: Floats, change: tuple[float, float, float]) -> Floats:
    """Return poses (k, 4, 4) with a change (yaw, x, y) of the step into one scan."""
    poses, before = poses.copy(), poses[BENT - 1]
    poses[BENT:] = before @ matrices(np.array([change]))[0] @ np.linalg.inv(before) @ poses[BENT:]
    return poses


def test_no_step_of_a_right_map_is_contradicted(refined: PlaneMapper) -> None:
    assert not len(contradicted_steps(refined.submaps, links_of(refined)))
    assert not len(refined.history.held)


@pytest.mark.parametrize("change", [(np.deg2rad(3.0), 0.0, 0.0), (0.0, 0.2, 0.0)])
def test_a_bent_step_is_contradicted(
    refined: PlaneMapper, change: tuple[float, float, float]
) -> None:
    submap = refined.submaps[0]
    wrong = replace(submap, poses=bent(submap.poses, change))
    assert contradicted_steps([wrong], links_of(refined)).tolist() == [BENT]


def test_a_held_step_is_an_equation_of_the_refinement(refined: PlaneMapper) -> None:
    history, scans = refined.history, np.arange(40)
    others = history.factors(scans)
    assert [BENT - 1, BENT] not in others.both.tolist()
    held = replace(history, held=np.array([BENT])).factors(scans)
    row = held.both.tolist().index([BENT - 1, BENT])
    np.testing.assert_allclose(held.motion[row], inverse(history.motion[BENT]))
    assert len(held) == len(others) + 1
    assert (held.sd[row] < others.sd.min(axis=0)).all() if len(others) else True
