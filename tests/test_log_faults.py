"""Simulated faults of a log: what they change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.shared import log_faults as faults
from relmap.core.errors import RelmapError
from relmap.datasets import ObservationLog
from relmap.simulation import simulate_figure_eight

LOG = simulate_figure_eight(density=60, iterations=120, seed=5).log
AT = 60


def rows_of(log: ObservationLog) -> set[tuple[float, ...]]:
    assert log.ids is not None
    rows = np.column_stack([log.iteration, log.ids, log.points_robot])
    return {tuple(row) for row in rows.tolist()}


def is_sound(log: ObservationLog) -> bool:
    """Return whether a log is in order, its rows are its own, and each id comes once in a scan."""
    assert log.ids is not None
    pairs = np.column_stack([log.iteration, log.ids])
    once = len(np.unique(pairs, axis=0)) == len(pairs)
    own = np.array_equal(log.rows, np.arange(len(log.rows)))
    return bool(once and own and (np.diff(log.iteration) >= 0).all())


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_what_faults_of_single_observations_do(seed: int, share: float) -> None:
    n = len(LOG.iteration)
    outliers = faults.gross_outliers(LOG, share, np.random.default_rng(seed))
    assert np.array_equal(outliers.iteration, LOG.iteration)
    assert (outliers.points_robot != LOG.points_robot).any(axis=1).sum() <= round(share * n)
    missed = faults.missed_detections(LOG, share, np.random.default_rng(seed))
    assert len(missed.iteration) == n - round(share * n)
    assert rows_of(missed) <= rows_of(LOG)
    ghosts = faults.ghosts(LOG, share, np.random.default_rng(seed))
    assert len(ghosts.iteration) == n + round(share * n)
    assert rows_of(ghosts) >= rows_of(LOG)
    assert is_sound(missed)
    assert is_sound(ghosts)


def test_duplicated_landmarks() -> None:
    chosen = np.unique(LOG.ids)[[7, 3]]
    made = faults.duplicated_landmarks(LOG, chosen, 0.01, np.random.default_rng(0))
    assert made.ids is not None
    assert is_sound(made)
    for rank, landmark in enumerate(sorted(chosen.tolist())):
        first, second = made.ids == landmark, made.ids == LOG.ids.max() + 1 + rank
        np.testing.assert_array_equal(made.iteration[first], made.iteration[second])
        apart = made.points_robot[first] - made.points_robot[second]
        assert 0 < np.abs(apart).max() < 0.06


def test_faults_of_whole_scans() -> None:
    mirrored = faults.mirrored_scan(LOG, AT)
    there = LOG.iteration == AT
    np.testing.assert_array_equal(mirrored.points_robot[~there], LOG.points_robot[~there])
    np.testing.assert_array_equal(
        mirrored.points_robot[there], LOG.points_robot[there] * [1, -1, 1]
    )
    lost = faults.lost_scans(LOG, AT, 10)
    assert not np.isin(lost.iteration, range(AT, AT + 10)).any()
    assert len(lost) == len(LOG)
    few = faults.few_landmarks(LOG, AT, 10)
    counts = np.bincount(few.iteration)
    assert (counts[AT : AT + 10] == 2).all()
    np.testing.assert_array_equal(
        np.delete(counts, range(AT, AT + 10)),
        np.delete(np.bincount(LOG.iteration), range(AT, AT + 10)),
    )
    back = faults.time_backwards(LOG, AT, 10)
    assert rows_of(back) != rows_of(LOG)
    assert rows_of(faults.time_backwards(back, AT, 10)) == rows_of(LOG)
    step = faults.big_step(LOG, AT, 10)
    assert len(step) == len(LOG) - 9
    for before, after in ((AT, AT), (AT + 10, AT + 1), (119, 110)):
        np.testing.assert_array_equal(
            step.points_robot[step.iteration == after], LOG.points_robot[LOG.iteration == before]
        )
    for made in (mirrored, lost, few, back, step):
        assert is_sound(made)


def test_impossible_faults_are_refused() -> None:
    with pytest.raises(RelmapError, match=r"share is 1\.5"):
        faults.ghosts(LOG, 1.5, np.random.default_rng(0))
    without = ObservationLog(LOG.points_robot, LOG.iteration, LOG.rows, 0, len(LOG))
    with pytest.raises(RelmapError, match="needs them"):
        faults.few_landmarks(without, AT, 10)
