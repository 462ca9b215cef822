"""The point variant of the mapper (section III)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relmap.core.scan import checked_ids, checked_points
from relmap.durable import DurableMapper
from relmap.points.basis import relative_map

if TYPE_CHECKING:
    from relmap.journal import RecordedScan


class PointMapper(DurableMapper):
    """Maps point landmarks, with six degrees of freedom in space or three in the plane.

    Parameters
    ----------
    config : MapperConfig, optional
    journal : path, optional
        A file to be begun that keeps every scan, so that `resume` can go on from it.
    run : dict, optional
        What the journal should tell about the run.

    Examples
    --------
    >>> import numpy as np
    >>> from relmap import PointMapper
    >>> corners = np.array([[2.0, 0.0], [0.0, 2.0], [3.0, 3.0]])
    >>> mapper = PointMapper()
    >>> for x in np.linspace(0.0, 0.5, 11):
    ...     labels = mapper.update(corners - [x, 0.0])
    >>> mapper.finish()
    >>> mapper.map.positions.round(6).tolist()
    [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [3.0, 3.0, 0.0]]
    """

    _variant = "points"

    def update(self, points: ArrayLike, ids: ArrayLike | None = None) -> NDArray[np.int64]:
        """Take in the observations of one iteration; see `RelativeMapper.update`."""
        if self._journal is None:
            return super().update(points, ids)
        self._journal.ready()
        points_robot = checked_points(points, self._store.dimension)
        known = None if ids is None else checked_ids(ids, len(points_robot))
        labels = super().update(points_robot, known)
        self._journal.append(points_robot, known, labels)
        return labels

    def refine(self) -> None:
        """Bring all landmarks to where all observations agree best; see `RelativeMapper.refine`."""
        self._note_call("refine")
        super().refine()

    def _again(self, scan: RecordedScan) -> NDArray[np.int64]:
        return self.update(scan.values, scan.ids)

    def _relative_map(self, block: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return relative_map(block)

    def _min_shared(self) -> int:
        return self._store.dimension
