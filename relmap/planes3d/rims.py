"""Where surfaces end: points just beyond them that a scan saw through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.planes3d.doubting import sight_of
from relmap.segmentation.space import Patches

BEYOND = 2.0
"""Distance of the points from the cells of a surface, in cells."""
EVERY = 4
"""One of so many cells is tried in a scan, others in the next ones."""


def with_rim(seen: Patches, iteration: int) -> Patches:
    """Return the planes of a scan, robot frame, with their rim; see `Patches`."""
    cells, of = (each[iteration % EVERY :: EVERY] for each in (seen.cells, seen.cell_patch))
    u, v = seen.axes[of, 0], seen.axes[of, 1]
    way = np.stack([u, -u, v, -v], axis=1)
    beyond = (cells[:, None] + BEYOND * seen.cell_m * way).reshape(-1, 3)
    tried = replace(seen, cells=beyond, cell_patch=np.repeat(of, 4))
    through = sight_of(np.eye(3), np.zeros(3), seen, tried).through
    return replace(seen, rim=beyond[through], rim_patch=tried.cell_patch[through])
