"""The optimal map of a log with known ids: batch least squares over all identified landmarks."""

from __future__ import annotations

import numpy as np

from relmap.comparison.baselines.base import SolvedAtTheEnd
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.comparison.baselines.frame_to_map import frame_to_map
from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.datasets.base import ObservationLog


def least_squares_map(log: ObservationLog) -> LandmarkMap:
    """Map the identified landmarks of a log by batch least squares.

    Iterations with fewer identified landmarks than determine a pose (two in the plane, three in
    space) are left out, as are landmarks that frame-to-map averaging, used for initialisation,
    cannot place.

    `log`: with ids. The map is in the frame of the first iteration that is used. Raises
    `RelmapError` if the log has no ids, or they do not connect into one map.
    """
    if log.ids is None:
        raise RelmapError("least squares with known ids: the log has no ids")
    start = frame_to_map(log).map
    log = _of_landmarks(log, start.landmark_ids)
    if log.ids is None or not len(log.ids):
        raise RelmapError("least squares with known ids: too few landmarks are identified")
    _, pose = np.unique(log.iteration, return_inverse=True)
    labels, landmark = np.unique(log.ids, return_inverse=True)
    dimension = log.points_robot.shape[1]
    places = start.positions[np.isin(start.landmark_ids, labels), :dimension]
    observations = Batch(log.points_robot, pose, landmark)
    return LandmarkMap(labels, in_space(batch_least_squares(observations, places)))


def _of_landmarks(log: ObservationLog, labels: Ints) -> ObservationLog:
    """Return the observations of some landmarks, in iterations that see enough of them."""
    assert log.ids is not None
    used = np.isin(log.ids, labels)
    seen = np.bincount(log.iteration[used] - log.first_iteration, minlength=len(log))
    used &= (seen >= log.points_robot.shape[1])[log.iteration - log.first_iteration]
    return log.only(used)


class BatchLeastSquares(SolvedAtTheEnd):
    """Solves for all poses and landmarks at once: a lower bound of the map error."""

    def _solved(self, log: ObservationLog) -> LandmarkMap:
        return least_squares_map(log)
