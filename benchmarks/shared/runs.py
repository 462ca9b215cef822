"""Runs of the point mapper on worlds with ids, and how far off their maps are."""

from __future__ import annotations

import numpy as np

from relmap import MapperConfig, PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import ObservationLog
from relmap.evaluation.metrics import majority_ids
from relmap.simulation import FigureEight


def ids_of(log: ObservationLog) -> Ints:
    """Return the ids (n,) of a log that has them."""
    assert log.ids is not None
    return log.ids


def mapped(
    log: ObservationLog, known: bool = True, config: MapperConfig | None = None
) -> tuple[PointMapper, list[Ints]]:
    """Map and refine a log, with its ids or without; return the mapper and the labels of scans."""
    mapper = PointMapper(config)
    scans = log.scans()
    labels = [mapper.update(scan.points_robot, scan.ids if known else None) for scan in scans]
    mapper.finish()
    mapper.refine()
    return mapper, labels


def true_ids(mapper: PointMapper, labels: list[Ints], log: ObservationLog) -> Ints:
    """Return the true ids of the mapped landmarks (m,), by the majority of their observations."""
    of = mapper.landmarks_of(np.concatenate(labels))
    stands_for = dict(zip(*majority_ids(of, ids_of(log))[:2], strict=True))
    return np.array([stands_for[label] for label in mapper.map.landmark_ids.tolist()])


def rmse(positions: Floats, truth: Floats) -> float:
    """Return the RMSE, metres, after rigid alignment."""
    R, t = fit_rigid(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - truth) ** 2, axis=1))))


def limit(world: FigureEight) -> float:
    """Return the RMSE of batch least squares over all observations, with the true ids."""
    batch = Batch(world.log.points_robot, world.log.iteration, ids_of(world.log))
    return rmse(batch_least_squares(batch, world.landmarks_map), world.landmarks_map)
