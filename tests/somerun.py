"""A result with random landmarks, for tests of pictures."""

from __future__ import annotations

import numpy as np

from relmap.io.results import Result
from tests.tables import NO_TRACKS, landmark_table, poses_along


def make_result(n: int, planar: bool = False, dynamic: int = 0) -> Result:
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (n, 3)) * [1, 1, 0 if planar else 0.2]
    status = np.where(np.arange(n) < dynamic, "dynamic", "static")
    seen = {"observations": np.arange(n) + 1, "level": np.arange(n) + 1}
    table = landmark_table(position, sd=rng.uniform(0.01, 0.1, n), status=status, **seen)
    poses, summary = poses_along(np.linspace(-40, 40, 20)), {"dimensions": 2 if planar else 3}
    return Result(table, NO_TRACKS, np.linspace(0, 19, 20), poses, summary)
