"""How the work grows: processor time of mapping, and n log n; shared by figures 12, 14 and 15."""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from relmap.datasets.base import ObservationLog
from relmap.figures.base import Watch, unwatched
from relmap.points.mapper import PointMapper
from relmap.simulation import simulate_figure_eight

MACHINE = "(milliseconds of one machine: compare ratios)"


def timed(log: ObservationLog) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Map a log without its ids, with one thread.

    Returns
    -------
    time_ms : (i,) float64
        Processor time of each iteration.
    landmark : (n,) int64
        Of each observation.
    """
    mapper, times_s, labels = PointMapper(), [], []
    with threadpool_limits(1):
        for scan in log.scans():
            began = process_time()
            labels.append(mapper.update(scan.points_robot))
            times_s.append(process_time() - began)
    return 1e3 * np.array(times_s), mapper.landmarks_of(np.concatenate(labels))


def median_times(
    log: ObservationLog, repeats: int, watch: Watch = unwatched
) -> NDArray[np.float64]:
    """Return the time of each iteration (i,), ms: the median of several runs."""
    return np.asarray(np.median([timed(log)[0] for _ in watch(range(repeats))], axis=0))


def warm_up() -> None:
    """Have everything compiled that is compiled when it is first used."""
    timed(simulate_figure_eight(density=100, iterations=100).log)


def n_log_n(n: NDArray[Any]) -> NDArray[np.float64]:
    """Return n log2 n."""
    return np.asarray(n * np.log2(n), dtype=np.float64)
