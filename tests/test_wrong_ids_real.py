"""Real logs with ids of which some are replaced: odometry keeps the map together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Ints
from relmap.datasets import ObservationLog, open_log
from relmap.evaluation.run import map_log
from relmap.evaluation.truth import read_truth
from tests.worlds import aligned_rmse


def replaced(log: ObservationLog) -> Ints:
    """Return the ids, a tenth of them those of landmarks that are not in view."""
    rng, ids = np.random.default_rng(1), log.ids.copy()
    names = np.unique(ids)
    for row in np.flatnonzero(rng.random(len(ids)) < 0.1):
        ids[row] = rng.choice(np.setdiff1d(names, ids[log.iteration == log.iteration[row]]))
    return ids


def swapped(log: ObservationLog) -> Ints:
    """Return the ids, two of them swapped for a fifth of the run."""
    rng, fifth = np.random.default_rng(1007), len(log) // 5
    begin = log.first_iteration + int(rng.integers(fifth, 3 * fifth))
    there = (log.iteration >= begin) & (log.iteration < begin + fifth)
    names, times = np.unique(log.ids[there], return_counts=True)
    one, other = rng.permutation(names[times >= 5])[:2]
    ids = np.where(there & (log.ids == one), other, log.ids)
    return np.where(there & (log.ids == other), one, ids)


@pytest.mark.parametrize("change", [replaced, swapped])
def test_wrong_ids_do_not_fold_a_real_map(
    shared_data: Path, change: Callable[[ObservationLog], Ints]
) -> None:
    """The maps were 3.6 and 3.1 m off; with the right ids the map is 0.06 m off."""
    folder = shared_data / "mrclam-dataset6"
    log = open_log(folder / "Robot1_Measurement.dat.gz")
    result = map_log(replace(log, ids=change(log)), association="known").result
    truth = read_truth(folder)
    at = {int(name): k for k, name in enumerate(truth.landmark_ids)}
    table = result.landmarks
    rows = [k for k in np.flatnonzero(result.mapped) if int(table.landmark[k]) in at]
    true = truth.landmarks_map[[at[int(table.landmark[k])] for k in rows], :2]
    assert len(rows) >= 14
    assert aligned_rmse(table.position[rows, :2], true) < 0.1
