"""A perfect result of a small world, with its truth and its log, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.datasets.base import ObservationLog
from relmap.evaluation.truth import Truth
from relmap.io.results import Result, Tracks
from tests.tables import landmark_table, poses_along

N, K = 5, 12
TRUE_MAP = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 4, 4]])


def make_truth() -> Truth:
    poses = poses_along(np.arange(K))
    return Truth(np.arange(N), TRUE_MAP, np.full(N, "static"), np.linspace(0.0, K - 1, K), poses)


def make_log() -> ObservationLog:
    """Every landmark in every iteration."""
    return ObservationLog.of_scans([np.zeros((N, 3))] * K, [np.arange(N)] * K)


def make_result() -> Result:
    """Return a perfect result in its own map frame; labels are the ids plus ten."""
    log, truth = make_log(), make_truth()
    turn = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    T_map_true = np.eye(4)
    T_map_true[:3, :3], T_map_true[:3, 3] = turn, [1, 2, 3]
    seen = {"observations": np.full(N, K), "first_iteration": np.zeros(N, np.int64)}
    seen |= {"last_iteration": np.full(N, K - 1), "landmark": np.arange(N) + 10}
    table = landmark_table(TRUE_MAP @ turn.T + [1, 2, 3], sd=np.full(N, 0.1), **seen)
    tracks = Tracks(log.iteration, log.rows, log.ids + 10)
    summary = {"scans": [0, K], "association": "nearest", "dimensions": 3}
    return Result(table, tracks, truth.stamps_s, T_map_true @ truth.poses, summary)


def with_table(result: Result, **columns: NDArray[Any]) -> Result:
    return replace(result, landmarks=replace(result.landmarks, **columns))
