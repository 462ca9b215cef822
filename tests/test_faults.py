"""Faults in the world and in the sensor: their effect on a log and on the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.shared import log_faults as faults
from relmap import PointMapper
from relmap.cli import main
from relmap.core.arrays import Floats, Ints
from relmap.core.association.rigidity import CARRIED, PLENTY, Rigidity
from relmap.core.landmarks import LandmarkMap
from relmap.datasets import ObservationLog, write_observation_csv
from relmap.evaluation.summary import ends_of
from relmap.evaluation.trust import MANY
from relmap.io.results import read_result
from relmap.simulation import simulate_figure_eight
from tests.commands import load
from tests.worlds import aligned_rmse, fed, finished, random_rotation, seen

pytestmark = pytest.mark.usefixtures("unrendered")

WORLD = simulate_figure_eight(density=60, iterations=120, seed=5)
LOG = WORLD.log
AT = 60


def mapped(log: ObservationLog, known: bool) -> PointMapper:
    return finished(PointMapper(), seen(log, known))


@cache
def mapped_without_faults(known: bool) -> LandmarkMap:
    return mapped(LOG, known).map


@pytest.mark.parametrize("known", [True, False])
def test_a_mirrored_scan_is_rejected_and_changes_nothing(known: bool) -> None:
    mirrored = mapped(faults.mirrored_scan(LOG, AT), known)
    without = mapped(faults.lost_scans(LOG, AT, 1), known)
    assert mirrored.rejected.tolist() == [AT]
    assert without.rejected.tolist() == []
    if known:
        np.testing.assert_array_equal(mirrored.map.positions, without.map.positions)
    else:
        assert len(mirrored.map.landmark_ids) == len(without.map.landmark_ids)


@pytest.mark.parametrize("seed", [0, 4, 10, 22])
def test_a_mirrored_scan_of_few_landmarks_is_rejected(seed: int) -> None:
    """Without ids, some of them lie in a plane (0, 10) or in a slab (4, 22) and fit rotated."""
    log = simulate_figure_eight(density=25, seed=seed).log
    part = faults.mirrored_scan(log, 450).between(430, 455)
    assert mapped(part, known=False).rejected.tolist() == [20]


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("first", [0, 30])
def test_rejected_iterations_are_the_callers(known: bool, first: int) -> None:
    mapper = fed(PointMapper(), (np.empty((0, 3)) for _ in range(first)))
    fed(mapper, seen(faults.mirrored_scan(LOG, 7).between(0, 20), known))
    assert mapper.rejected.tolist() == [first + 7]


@pytest.mark.parametrize("known", [True, False])
def test_the_first_scan_may_be_the_wrong_one(known: bool) -> None:
    mapper = mapped(faults.mirrored_scan(LOG, 0), known)
    assert mapper.rejected.tolist() == ([1] if known else [0])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("make", [faults.lost_scans, faults.few_landmarks, faults.big_step])
def test_gaps_are_bridged(make: Callable[..., ObservationLog], known: bool) -> None:
    mapper = mapped(make(LOG, AT, 10), known)
    assert len(mapper.submaps) == 1
    assert len(mapper.map.landmark_ids) > 0.9 * len(mapped_without_faults(known).landmark_ids)


def test_gross_outliers_under_right_ids() -> None:
    sound = mapped_without_faults(True)
    mapper = mapped(faults.gross_outliers(LOG, 0.05, np.random.default_rng(0)), known=True)
    found = mapper.map
    both = np.intersect1d(sound.landmark_ids, found.landmark_ids)
    assert len(both) > 0.9 * len(sound.landmark_ids)
    truth = WORLD.landmarks_map[both]
    error, before = (
        aligned_rmse(one.positions[np.isin(one.landmark_ids, both)], truth)
        for one in (found, sound)
    )
    assert error < 2 * before
    assert mapper.rejected.tolist() == []


@settings(max_examples=300)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.sampled_from([0.0, 0.05]))
def test_rigid_scans_are_accepted(seed: int, d: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    world, rigidity = rng.uniform(-20, 20, (30, d)), Rigidity()
    R, t = np.eye(d), np.zeros(d)
    for _ in range(20):
        R, t = R @ random_rotation(d, 0.3, rng), t + rng.uniform(-1, 1, d)
        seen = rng.permutation(30)[: rng.integers(0, 31)]
        points = (world[seen] - t) @ R + sigma * rng.standard_normal((len(seen), d))
        np.testing.assert_array_equal(rigidity.checked(seen, points), seen)


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_scans_that_are_not_rigid_are_rejected(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    world, ids, rigidity = rng.uniform(-20, 20, (30, d)), np.arange(30), Rigidity()

    def scan() -> Floats:
        return world + 0.02 * rng.standard_normal((30, d))

    for _ in range(5):
        assert rigidity.checked(ids, scan()) is not None
    mirror = np.ones(d)
    mirror[1] = -1
    assert rigidity.checked(ids, scan() * mirror) is None
    assert rigidity.checked(ids, scan()[rng.permutation(30)]) is None
    np.testing.assert_array_equal(rigidity.checked(ids, scan()), ids)
    off = scan()
    off[4] += 60.0
    np.testing.assert_array_equal(rigidity.checked(ids, off), np.where(ids == 4, -1, ids))
    # It is there again: it has gone there.
    np.testing.assert_array_equal(rigidity.checked(ids, off + 0.01), ids)


@pytest.mark.parametrize("new", [6, 30])
def test_among_wrong_ids_a_new_id_is_replaced_by_the_expected_one(new: int) -> None:
    rng = np.random.default_rng(0)
    world, ids, rigidity = rng.uniform(-20, 20, (31, 3)), np.arange(31), Rigidity()
    for _ in range(5):
        rigidity.checked(ids[:30], world[:30] + 0.02 * rng.standard_normal((30, 3)))
    swapped, read = ids.copy(), ids.copy()
    swapped[[4, 9]] = 9, 4
    swapped[new] = read[new] = 77
    expected = np.where(ids == 30, 77 if new == 30 else 30, ids)
    np.testing.assert_array_equal(rigidity.checked(swapped, world), expected)
    np.testing.assert_array_equal(rigidity.checked(read, world), expected)


def test_a_misread_id_does_not_capture_a_landmark() -> None:
    rng = np.random.default_rng(0)
    world, ids, rigidity = rng.uniform(-20, 20, (31, 3)), np.arange(31), Rigidity()
    for _ in range(5):
        rigidity.checked(ids[:30], world[:30])
    for strange in (77, 30, 30):
        seen = np.append(ids[:30], strange)
        seen[[4, 9]] = 9, 4
        found = rigidity.checked(seen, world)
        np.testing.assert_array_equal(found, np.append(ids[:30], strange))


@pytest.mark.parametrize(("apart_m", "found"), [(0.1, -1), (5.0, 9)])
def test_a_misread_id_beside_two_missed_landmarks_is_of_neither(apart_m: float, found: int) -> None:
    rng = np.random.default_rng(0)
    world, ids, rigidity = rng.uniform(-20, 20, (30, 2)), np.arange(30), Rigidity()
    world[8] = world[9] + [apart_m, 0.0]
    for _ in range(5):
        rigidity.checked(ids, world + 0.02 * rng.standard_normal((30, 2)))
    seen = np.delete(ids, [4, 8])
    read = np.where(seen == 9, 4, seen)
    checked = rigidity.checked(read, world[seen] + 0.02 * rng.standard_normal((28, 2)))
    np.testing.assert_array_equal(checked, np.where(seen == 9, found, seen))


@pytest.mark.parametrize(
    ("missed", "misread", "expected"), [(0, False, -1), (1, False, 9), (1, True, -1)]
)
def test_a_missed_landmark_may_be_farther_off_unless_ids_are_doubtful(
    missed: int, misread: bool, expected: int
) -> None:
    rng = np.random.default_rng(0)
    world, ids, rigidity = rng.uniform(-20, 20, (30, 2)), np.arange(30), Rigidity()
    for _ in range(5):
        rigidity.checked(ids, world)
    if missed:
        seen = np.delete(ids, 9)
        off = np.where(seen[:, None] == 4, 30.0 * misread, 0.0)
        rigidity.checked(seen, world[seen] + off)
    moved = world.copy()
    moved[9, 0] += 1.5 * 0.02 * np.ptp(world, axis=0).max()  # 1.5 times the gate
    found = rigidity.checked(ids, moved)
    assert found is not None
    assert found[9] == expected


def test_overruled_observations_are_named() -> None:
    log, mapper = swapped_in(LOG, AT), PointMapper()
    labels = [mapper.update(scan.points_robot, scan.ids) for scan in log.scans()]
    assert mapper.rejected_observations.tolist() == [[AT, 0], [AT, 1]]
    np.testing.assert_array_equal(np.concatenate(labels), LOG.ids)


def swapped_in(log: ObservationLog, iteration: int) -> ObservationLog:
    """Swap the ids of the first two observations of an iteration."""
    ids, first = log.ids.copy(), int(np.searchsorted(log.iteration, iteration))
    ids[[first, first + 1]] = ids[[first + 1, first]]
    return replace(log, ids=ids)


def test_too_little_in_common_is_not_judged() -> None:
    rng = np.random.default_rng(0)
    rigidity = Rigidity()
    for n in (PLENTY - 1, PLENTY - 1, 3, 0, 1):
        ids = np.arange(n)
        np.testing.assert_array_equal(rigidity.checked(ids, rng.uniform(-9, 9, (n, 3))), ids)
    assert CARRIED > 0


@pytest.mark.parametrize("n", [0, 3, MANY, MANY + 1, 1000])
def test_many_rejected_iterations_are_listed_by_their_ends(n: int) -> None:
    listed = ends_of(np.arange(n), "iterations")
    assert listed["count"] == n
    assert len(listed["iterations"]) == min(n, MANY)
    assert listed["iterations"][:1] == list(range(n))[:1]
    assert listed["iterations"][-1:] == list(range(n))[-1:]


def test_the_summary_names_rejected_iterations(tmp_path: Path) -> None:
    log = faults.mirrored_scan(LOG, AT).between(40, 80)
    write_observation_csv(tmp_path / "observations.csv", log)
    for association in ("known", "nearest"):
        out = tmp_path / association
        source = str(tmp_path / "observations.csv")
        assert main(["map", source, "-o", str(out), "--association", association]) == 0
        summary = load(out / "summary.json")
        assert summary["rejected_iterations"] == {"count": 1, "iterations": [AT]}
        assert summary["rejected_observations"] == {"count": 0, "rows": []}


def test_the_result_names_overruled_observations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = swapped_in(LOG, AT)
    write_observation_csv(tmp_path / "observations.csv", log)
    source, out = str(tmp_path / "observations.csv"), tmp_path / "r"
    assert main(["map", source, "-o", str(out), "--association", "known"]) == 0
    assert "; overruled ids: of 2 observations" in capsys.readouterr().out
    first = int(np.searchsorted(log.iteration, AT))
    summary = load(out / "summary.json")
    assert summary["rejected_observations"] == {"count": 2, "rows": [first, first + 1]}
    tracks = read_result(out).tracks
    overruled = tracks.rejected_id >= 0
    np.testing.assert_array_equal(tracks.row[overruled], [first, first + 1])
    np.testing.assert_array_equal(tracks.landmark, LOG.ids)
    np.testing.assert_array_equal(tracks.rejected_id[overruled], log.ids[first : first + 2])


def test_observations_without_an_id_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ids = np.where(np.arange(len(LOG.ids)) % 3 == 0, -1, LOG.ids)
    write_observation_csv(tmp_path / "observations.csv", replace(LOG, ids=ids))
    source, said = str(tmp_path / "observations.csv"), f"no id: {np.sum(ids < 0)} observations"
    assert main(["map", source, "-o", str(tmp_path / "r"), "--association", "known"]) == 0
    assert said in capsys.readouterr().out
    assert main(["map", source, "-o", str(tmp_path / "s")]) == 0
    assert "no id" not in capsys.readouterr().out


def test_unfiltered_gross_outliers_give_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def unchecked(_: Rigidity, ids: Ints, __: object) -> Ints:
        return ids

    monkeypatch.setattr(Rigidity, "checked", unchecked)
    log = simulate_figure_eight(density=25, seed=0).log
    mapper = mapped(faults.gross_outliers(log, 0.05, np.random.default_rng([0, 3])), known=True)
    mapper.refine()
    assert np.isfinite(mapper.map.positions).all()
