"""Data behind the paper's figures, small enough to be checked by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relmap.core.state.store import ObservationStore
from relmap.datasets.base import ObservationLog
from relmap.evaluation.evaluate import Evaluation
from relmap.figures.base import n_log_n
from relmap.figures.figure12 import Comparisons
from relmap.figures.figure13 import EightMap
from relmap.figures.figure14_15 import DensityTiming, LoopTiming
from relmap.figures.figure16 import Curve, ErrorCurves
from relmap.figures.point_chart import ChartPicture, chart_picture

# Who is seen in iterations 0 to 7.  Landmark 2, the seed, is seen in 1 to 6.
SEEN = {
    0: [0, 1, 2, 3],
    1: [1, 2, 3, 4, 5],
    2: [1, 2, 3, 4, 5, 6],
    3: [2, 3, 4, 5, 6],
    4: [2, 3, 4, 5, 6, 7],
    5: [0, 7],
    6: [1, 2, 3, 4, 5, 6, 7],
}


def store() -> ObservationStore:
    store = ObservationStore()
    for iteration in range(8):
        seen = np.array([landmark for landmark, when in SEEN.items() if iteration in when])
        store.append(seen, np.zeros((len(seen), 3)))
    return store


def log() -> ObservationLog:
    """The same observations with their landmarks as ids."""
    landmarks, iterations = store().seen(0, 8)
    n = len(landmarks)
    return ObservationLog(np.zeros((n, 3)), iterations, np.arange(n), 0, 8, landmarks)


def chart() -> ChartPicture:
    return chart_picture(store(), 2, 0, 8)


def dipping_chart() -> ChartPicture:
    """Six landmarks whose areas are 10, 20, 30, 16, 15, 18."""
    visible = np.arange(10) < np.array([10, 10, 10, 4, 3, 3])[:, None]
    return ChartPicture(0, np.arange(6), visible, 6)


def comparisons() -> Comparisons:
    n, dynamic = np.array([20, 50, 100]), np.array([0.1, 0.4, 0.7])
    bound = n_log_n(n)
    counts = np.stack([0.3 * bound, 0.9 * bound, 1.1 * bound])[:, :, None].repeat(5, axis=2)
    return Comparisons(n, dynamic, counts.astype(np.int64), counts % 2 < 1)


def loop() -> LoopTiming:
    visible = np.full(80, 100)
    time_ms = np.where(np.arange(80) % 10 == 0, 5.0, 1.0)
    return LoopTiming(time_ms, visible, np.arange(1, 81) * 10, np.arange(1, 81) * 9)


def densities(power: float = 1.0) -> DensityTiming:
    n = np.array([10.0, 40.0, 160.0, 640.0])
    time_ms = 0.2 + 1e-4 * n_log_n(n) ** power
    return DensityTiming(n, time_ms, 2 * time_ms)


def eight(**found: Any) -> EightMap:
    rng = np.random.default_rng(0)
    landmarks, path = rng.uniform(-50, 50, (12, 3)), np.linspace([-50, 0, 0], [50, 0, 20], 9)
    evaluation = replace(Evaluation(landmark_rmse_m=0.1), **found)
    return EightMap(landmarks + 0.1, path + 0.1, landmarks, path, evaluation)


def errors(**ends_m: tuple[float, float]) -> ErrorCurves:
    """Three seeds whose median error at the end is given for each method, Gaussian and flat."""
    at, spread = np.array([9, 19]), np.array([0.9, 1.0, 1.1])
    return {
        noise: {
            name: Curve(at, np.column_stack([np.full(3, 0.5), end[k] * spread]))
            for name, end in ends_m.items()
        }
        for k, noise in enumerate(("Gaussian", "flat"))
    }
