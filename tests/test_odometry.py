"""Odometry: accepted motions, and storage in journals and saved states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from relmap import PlaneMapper, PointMapper, RelmapError, motion_from_velocity
from relmap.core.odometry import checked_odometry


def test_three_numbers_are_a_motion_in_the_plane() -> None:
    motion = checked_odometry([1.0, 2.0, 0.3])
    assert_allclose(motion[:2, 3], [1, 2])
    assert_allclose(Rotation.from_matrix(motion[:3, :3]).as_rotvec(), [0, 0, 0.3])


def test_seven_numbers_and_a_matrix_are_the_same_motion() -> None:
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3])
    motion = checked_odometry([1.0, 2.0, 3.0, *turn.as_quat()])
    assert_allclose(motion[:3, :3], turn.as_matrix(), atol=1e-15)
    assert_array_equal(checked_odometry(motion), motion)


def test_an_unknown_motion_is_nan() -> None:
    assert np.isnan(checked_odometry([np.nan] * 3)).all()


@pytest.mark.parametrize(
    ("odometry", "message"),
    [
        ([1.0, 2.0], "shape"),
        ([1.0, np.nan, 0.0], "finite"),
        ([1.0, np.inf, 0.0], "finite"),
        ([0.0] * 7, "quaternion"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "rotation"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "rotation"),
        ("ahead", "odometry must be"),
    ],
)
def test_invalid_motions_are_refused(odometry: object, message: str) -> None:
    with pytest.raises(RelmapError, match=message):
        PointMapper().update(np.zeros((0, 2)), odometry=odometry)  # type: ignore[arg-type]


@pytest.mark.parametrize(("speed", "rate"), [(2.0, 0.0), (-1.0, 0.4), (1.0, 7.0), (0.0, 1.0)])
def test_constant_speed_and_rate_are_many_short_motions(speed: float, rate: float) -> None:
    steps, total = 20_000, np.eye(4)
    short = checked_odometry([speed * 1.5 / steps, 0.0, rate * 1.5 / steps])
    for _ in range(steps):
        total = total @ short
    assert_allclose(checked_odometry(motion_from_velocity(speed, rate, 1.5)), total, atol=1e-3)


def fed(mapper: PointMapper | PlaneMapper) -> None:
    for k in range(5):
        motion = None if k in (0, 3) else [0.5, 0.0, 0.1]
        mapper.update(np.empty((0, 2)), odometry=motion)


@pytest.mark.parametrize("kind", [PointMapper, PlaneMapper])
def test_a_journal_and_a_saved_state_keep_odometry(
    tmp_path: Path, kind: type[PointMapper] | type[PlaneMapper]
) -> None:
    mapper = kind(journal=tmp_path / "journal.sqlite")
    fed(mapper)
    before = mapper.engine.motions.over(5)
    assert np.isfinite(before).all(axis=(1, 2)).tolist() == [False, True, True, False, True]
    mapper.close()
    mapper.save(tmp_path / "mapper.npz")
    for other in (
        kind.resume(tmp_path / "journal.sqlite"),
        kind.load(tmp_path / "mapper.npz"),
    ):
        assert_array_equal(other.engine.motions.over(5), before)
        other.close()
