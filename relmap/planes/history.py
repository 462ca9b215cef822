"""A view on all observations of walls, and on how the robot went from scan to scan."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PlaneHistory:
    """Columns of the store of observations (Fig. 3), and what the registration found of each scan.

    Attributes
    ----------
    iteration : (n,) int64, ascending
    plane : (n,) int64
        Number of the wall, as when it was seen.
    ends : (n, 2, 2) float64, robot frame, metres
        Its right and left end.
    sd : (n,) float64, metres
        How sure the distance of its middle is.
    z_extent : (n, 2) float64, metres
        Lowest and highest z.
    corner : (n, 2) int64
        Corner that either end is; -1 where it is not static.
    motion : (i, 3) float64
        From the robot frame before into that of each iteration: yaw, x, y; rough.
    submap : (i,) int64
        Submap of each iteration; -1 where nothing ties it to any.
    """

    iteration: NDArray[np.int64]
    plane: NDArray[np.int64]
    ends: NDArray[np.float64]
    sd: NDArray[np.float64]
    z_extent: NDArray[np.float64]
    corner: NDArray[np.int64]
    motion: NDArray[np.float64]
    submap: NDArray[np.int64]

    @property
    def n_iterations(self) -> int:
        """How many scans were seen, those without walls included."""
        return len(self.motion)

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
