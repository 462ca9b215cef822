"""The point variant of the mapper (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.mapper import RelativeMapper
from relmap.points.basis import relative_map


class PointMapper(RelativeMapper):
    """Maps point landmarks, with six degrees of freedom in space or three in the plane.

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

    def _relative_map(self, block: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return relative_map(block)

    def _min_shared(self) -> int:
        return self._store.dimension
