"""A result with random landmarks, for tests of pictures."""

from __future__ import annotations

import numpy as np

from relmap.core.landmarks import LandmarkTable
from relmap.io.results import Result, Tracks


def make_result(n: int, planar: bool = False, dynamic: int = 0) -> Result:
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (n, 3)) * [1, 1, 0 if planar else 0.2]
    status = np.where(np.arange(n) < dynamic, "dynamic", "static")
    numbers = np.arange(n)
    table = LandmarkTable(
        numbers,
        position,
        rng.uniform(0.01, 0.1, n),
        numbers + 1,
        numbers,
        numbers,
        numbers + 1,
        status,
        np.zeros(n, np.int64),
        np.full(n, -1),
    )
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, 0, 3] = np.linspace(-40, 40, 20)
    nothing = np.empty(0, np.int64)
    summary = {"dimensions": 2 if planar else 3}
    tracks = Tracks(nothing, nothing, nothing)
    return Result(table, tracks, np.linspace(0, 19, 20), poses, summary)
