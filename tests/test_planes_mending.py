"""Where walls repeat, links a period off are replaced by the usual step."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import relmap.planes.remapping
from relmap.core.arrays import Floats, Ints
from relmap.planes import PlaneMapper
from relmap.planes.linking.registration import PlaneRegistration
from tests.test_planes_periods import LENGTH_M, driven, judged

STEADY_M = np.arange(1.0, LENGTH_M - 1.0, 1.15)


def changing(*parts: tuple[float, float]) -> Floats:
    """Return how far a robot is along the corridor whose steps change, each from some place on."""
    along_m, ends = [1.0], [at for at, _ in parts[1:]] + [LENGTH_M - 1.0]
    for (_, step_m), end in zip(parts, ends, strict=True):
        while along_m[-1] < end:
            along_m.append(along_m[-1] + step_m)
    return np.array(along_m[:-1])


def unmended(along_m: Floats, monkeypatch: pytest.MonkeyPatch) -> PlaneMapper:
    """Return the map in which no link is replaced."""
    with monkeypatch.context() as patch:
        patch.setattr(relmap.planes.remapping, "MENDED", 0)
        return driven(along_m)


@pytest.mark.parametrize("step_m", [1.0, 1.15, 1.5])
def test_steps_a_period_off_are_mended_and_stay_listed(
    step_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    along_m = np.arange(1.0, LENGTH_M - 1.0, step_m)
    before, was_wrong = judged(unmended(along_m, monkeypatch), along_m)
    mapper = driven(along_m)
    scans, wrong = judged(mapper, along_m)
    assert was_wrong.sum() >= 5
    assert not wrong.any()
    assert np.isin(np.intersect1d(before[was_wrong], scans), mapper.weak_links).all()
    iterations, poses = mapper.paths[0]
    assert abs(np.ptp(poses[:, 0, 3]) - np.ptp(along_m[iterations])) < 0.3
    assert np.ptp(poses[:, 0, 3]) > 15.0


@pytest.mark.parametrize(
    "parts",
    [
        ((0.0, 1.15), (8.0, 0.4), (18.0, 1.15)),
        ((0.0, 0.4), (10.0, 1.0)),
        ((0.0, 0.5), (14.0, 2.0)),
        ((0.0, 0.5), (6.0, 1.5), (10.0, 0.5), (16.0, 1.5)),
    ],
)
def test_right_steps_of_a_robot_that_changes_its_speed_stay(
    parts: tuple[tuple[float, float], ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its short steps look like long ones that are a period off."""
    along_m = changing(*parts)
    before, was_wrong = judged(unmended(along_m, monkeypatch), along_m)
    scans, wrong = judged(driven(along_m), along_m)
    assert len(scans) >= len(before)
    assert not np.isin(scans[wrong], before[~was_wrong]).any()


def test_labels_from_before_are_those_of_most_observations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All scans are mapped again, with other numbers: a number may have been of several walls."""
    before = unmended(STEADY_M, monkeypatch).history.plane
    mapper = driven(STEADY_M)
    assert before.max() < mapper.history.plane.min()
    now = mapper.landmarks_of(mapper.history.plane)
    assert np.array_equal(np.unique(now), mapper.planes.plane)
    for number, label in zip(
        np.unique(before), mapper.landmarks_of(np.unique(before)), strict=True
    ):
        walls, counts = np.unique(now[before == number], return_counts=True)
        assert counts[walls == label] == counts.max()


def replaced(mapper: PlaneMapper) -> Ints:
    """Return the scans (k,) whose links were replaced."""
    registration = mapper.engine.association.registration
    assert isinstance(registration, PlaneRegistration)
    return np.array([*registration.links.instead], dtype=np.int64)


def driven_again(mapper: PlaneMapper, finished_at: int, odometry: list[float] | None) -> None:
    """Map the scans of a corridor, and finish after `finished_at` of them, and in the end."""
    walls = driven(STEADY_M)
    registration = walls.engine.association.registration
    assert isinstance(registration, PlaneRegistration)
    for scan in range(walls.n_iterations):
        own = walls.history.iteration == scan
        ends, kind = walls.history.ends[own], np.full((own.sum(), 2), "open")
        beams = registration.links.beams.given(scan).points
        mapper.update(SimpleNamespace(ends=ends, end_type=kind), beams=beams, odometry=odometry)
        if scan + 1 == finished_at:
            mapper.finish()
    mapper.finish()


def test_replaced_steps_stay_listed_if_odometry_follows() -> None:
    mapper = driven(STEADY_M)
    scans = replaced(mapper)
    assert len(scans) >= 5
    assert np.isin(scans, mapper.weak_links).all()
    nothing = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2)))
    mapper.update(nothing, odometry=[0, 0, 0])
    mapper.finish()
    assert np.isin(scans, mapper.weak_links).all()


def test_with_odometry_nothing_is_replaced() -> None:
    """It determines the steps; and it would be lost if all scans were mapped again."""
    mapper = PlaneMapper()
    driven_again(mapper, 0, [1.15, 0.0, 0.0])
    assert not len(replaced(mapper))
    assert len(mapper.engine.motions)


def test_finishing_again_changes_nothing_and_the_state_is_saved(tmp_path: Path) -> None:
    mapper = driven(STEADY_M)
    mapper.save(tmp_path / "mapper.npz")
    loaded = PlaneMapper.load(tmp_path / "mapper.npz")
    weak, poses = mapper.weak_links, mapper.trajectory
    mapper.finish()
    mapper.refine()
    assert np.array_equal(mapper.trajectory, poses, equal_nan=True)
    assert np.array_equal(loaded.trajectory, poses, equal_nan=True)
    assert np.array_equal(loaded.weak_links, weak)
    assert np.array_equal(loaded.landmarks_of(np.arange(9)), mapper.landmarks_of(np.arange(9)))


def test_a_journal_is_resumed_in_the_middle(tmp_path: Path) -> None:
    """Labels go on from those of the scans that were mapped again."""
    mapper = PlaneMapper(journal=tmp_path / "run.sqlite")
    driven_again(mapper, len(STEADY_M) - 2, None)
    mapper.flush()
    resumed = PlaneMapper.resume(tmp_path / "run.sqlite")
    resumed.finish()
    assert np.array_equal(resumed.history.plane, mapper.history.plane)
    assert np.array_equal(resumed.trajectory, mapper.trajectory, equal_nan=True)
    assert mapper.history.plane.min() > 0
