"""A third kind of landmark maps with no change in the engine: signs, which have a direction."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core import afterwards, readout, repairing
from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association import Registration
from relmap.core.config import MapperConfig
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.mapper import RelativeMapper
from relmap.core.model import LandmarkModel
from relmap.core.state.store import Rows, Shown
from relmap.core.state.table import LandmarkState
from tests.worlds import turn

NEAR_M = 0.6
N = 40


class NearestSign(Registration):
    """Matches signs to those of the scan before: near, and with nearly their direction."""

    def __init__(self) -> None:
        self._before, self._numbers, self._n = np.empty((0, 3)), np.empty(0, dtype=np.int64), 0

    def match(self, seen: Floats, ids: Ints | None) -> Ints:
        found = np.full(len(seen), -1)
        if len(self._before) and len(seen):
            away, nearest = cKDTree(self._before[:, :2]).query(seen[:, :2])
            at = np.asarray(nearest)
            same = (away < NEAR_M) & (np.cos(seen[:, 2] - self._before[at, 2]) > 0.9)
            found[same] = self._numbers[at[same]]
        new = found < 0
        found[new] = self._n + np.arange(new.sum())
        self._n += int(new.sum())
        self._before, self._numbers = seen, found
        return found


class SignModel:
    """A sign and the spot 1 m before it are two points at rest: one sign fixes a group."""

    columns: Rows = {  # noqa: RUF012
        "landmark": np.empty(0, dtype=np.int64),
        "location": np.empty((0, 2)),
        "heading": np.empty(0),
    }
    keeps_observations = False
    noise_spread = position_spread = 1.0
    drift_m = 1.0

    def association(self, config: MapperConfig) -> Registration:
        return NearestSign()

    def rows(self, seen: Floats, found: Ints) -> Rows:
        return {"landmark": 2 * found, "location": seen[:, :2], "heading": seen[:, 2]}

    def points(self, rows: Rows) -> Shown:
        heading, n = rows["heading"], len(rows["heading"])
        before = rows["location"] + np.column_stack([np.cos(heading), np.sin(heading)])
        landmarks = rows["landmark"] // 2 * 2
        return Shown(
            np.column_stack([landmarks, landmarks + 1]).ravel(),
            np.stack([rows["location"], before], axis=1).reshape(-1, 2),
            np.full(n, 2),
        )

    def average_in_basis(self, block: Floats) -> Floats | None:
        axis = block[1] - block[0]
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        x, y = axis.T
        R = np.stack([np.stack([x, y], axis=1), np.stack([-y, x], axis=1)], axis=1)
        return np.asarray(np.einsum("iab,gib->gia", R, block - block[0]).mean(axis=1))

    def min_shared(self, dimension: int) -> int:
        return 2

    def least_noise_m(self, rows: Rows) -> float:
        return 0.0

    def compared(self, landmarks: Ints) -> Ints:
        return np.asarray(landmarks[landmarks % 2 == 0])

    def may_be(self, table: LandmarkState, new: Ints, old: Ints) -> Bools:
        return np.ones(len(new), dtype=bool)


def test_signs_are_mapped_by_the_engine_as_it_is() -> None:
    rng = np.random.default_rng(3)
    x, y = np.divmod(np.arange(N), 4)
    signs = np.column_stack([3.0 * x, 3.0 * y - 4.5, np.zeros(N)]) + rng.uniform(-1, 1, (N, 3))
    model: LandmarkModel = SignModel()
    engine = RelativeMapper(model, MapperConfig())
    seen_from: list[tuple[int, int]] = []
    for k in range(120):
        yaw = 0.1 * np.sin(k / 10)
        there = (signs[:, :2] - [0.2 * k, 0.0]) @ turn(yaw)
        near = np.flatnonzero(np.linalg.norm(there, axis=1) < 8)
        noise = rng.normal(0.0, 0.01, (len(near), 3)) * [1.0, 1.0, 0.5]
        scan = np.column_stack([there[near], signs[near, 2] - yaw]) + noise
        found = engine.update(scan, None)
        seen_from += zip(found.tolist(), near.tolist(), strict=True)
    afterwards.finish(engine)
    repairing.refine(engine)
    mapped = readout.landmark_map(engine)
    sign_of = dict(seen_from)
    own = mapped.landmark_ids % 2 == 0
    true = signs[[sign_of[n // 2] for n in mapped.landmark_ids[own].tolist()], :2]
    positions = mapped.positions[own, :2]
    R, t = fit_rigid(positions, true)
    assert own.sum() >= 30
    assert np.linalg.norm(positions @ R.T + t - true, axis=1).max() < 0.05
