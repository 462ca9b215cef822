"""All observations of walls, untransformed, as they were seen (Fig. 3)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relmap.core.state.growing import GrowingArray
from relmap.planes.observation import PlaneObservation


class PlaneHistory:
    """Structure of arrays, a row for each wall in each iteration, in the order of seeing.

    Attributes
    ----------
    n_iterations : int
    """

    STATE = "n_iterations _iteration _plane _ends _sd _z_extent _motion _corner _submap"

    def __init__(self) -> None:
        self.n_iterations = 0
        self._iteration: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._plane: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._ends: GrowingArray[np.float64] = GrowingArray(np.float64, (2, 2))
        self._sd: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._z_extent: GrowingArray[np.float64] = GrowingArray(np.float64, (2,))
        self._motion: GrowingArray[np.float64] = GrowingArray(np.float64, (3,))
        self._corner: GrowingArray[np.int64] = GrowingArray(np.int64, (2,))
        self._submap: GrowingArray[np.int64] = GrowingArray(np.int64)

    @property
    def iteration(self) -> NDArray[np.int64]:
        """When; (n,) ascending."""
        return self._iteration.values

    @property
    def plane(self) -> NDArray[np.int64]:
        """Number of the wall, as when it was seen; (n,)."""
        return self._plane.values

    @property
    def ends(self) -> NDArray[np.float64]:
        """Its right and left end (n, 2, 2), robot frame, metres."""
        return self._ends.values

    @property
    def sd(self) -> NDArray[np.float64]:
        """How sure the distance of its middle is; (n,) metres."""
        return self._sd.values

    @property
    def z_extent(self) -> NDArray[np.float64]:
        """Lowest and highest z; (n, 2) metres."""
        return self._z_extent.values

    @property
    def corner(self) -> NDArray[np.int64]:
        """Corner that either end is; (n, 2), -1 where it is not static."""
        return self._corner.values

    @property
    def motion(self) -> NDArray[np.float64]:
        """From the robot frame before into that of each iteration: yaw, x, y; (i, 3), rough."""
        return self._motion.values

    @property
    def submap(self) -> NDArray[np.int64]:
        """Submap of each iteration; (i,), -1 where nothing ties it to any."""
        return self._submap.values

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First iteration of each submap and one after its last, those of most iterations first."""
        edges = np.flatnonzero(np.diff(self.submap, prepend=-1, append=-1)).tolist()
        spans = [(a, b) for a, b in pairwise(edges) if self.submap[a] >= 0]
        return sorted(spans, key=lambda span: span[0] - span[1])

    def within(self, span: tuple[int, int]) -> slice:
        """Return the rows of the iterations from the first of a span up to its end."""
        begin, end = np.searchsorted(self.iteration, span).tolist()
        return slice(begin, end)

    def append(
        self,
        planes: NDArray[np.int64],
        corners: NDArray[np.int64],
        seen: PlaneObservation,
        motion: NDArray[np.float64],
        submap: int = 0,
    ) -> None:
        """Store one iteration: walls `planes` (m,) with corners (m, 2), and the motion (3,)."""
        self._motion.extend(motion[None])
        self._submap.extend(np.array([submap]))
        self._iteration.extend(np.full(len(seen), self.n_iterations))
        self._plane.extend(planes)
        self._ends.extend(seen.ends)
        self._sd.extend(seen.sd)
        self._z_extent.extend(seen.z_extent)
        self._corner.extend(corners)
        self.n_iterations += 1
