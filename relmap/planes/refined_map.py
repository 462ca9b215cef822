"""The refined map: solving, closing loops and joining walls, in turns.

Which tracks are one wall shows only where the map is good, and the map is good only where tracks
that are one wall are one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.planes.assembly import Assembled, WallNumbers, assemble
from relmap.planes.closing import walls_seen_again
from relmap.planes.history import PlaneHistory
from relmap.planes.joining import join_pairs, join_walls
from relmap.planes.solving import refined, refined_to_the_noise
from relmap.planes.stitching import stitched, without_strays

WIDELY = ((2, 1e4), (1, 300.0), (1, 50.0), (1, 15.0), (2, 5.0))
"""Solutions that loops are closed by, however far the map has drifted."""
CLOSED = 3
"""How often loops are looked for, each time with less drift left."""
ROUGHLY = ((1, 20.0), (1, 8.0), (2, 5.0))
"""Solutions that walls are joined by; see `relmap.planes.solving.refined`."""
JOINED = 4
"""How often walls that lie on one another are joined and the map refined again."""


def refined_map(
    history: PlaneHistory,
    numbers: WallNumbers,
    path: NDArray[np.float64],
    moving: NDArray[np.bool_],
) -> tuple[Assembled, WallNumbers] | None:
    """Bring walls, corners and poses to where all observations agree best.

    Walls that come to lie on one another are joined, which closes loops.

    Parameters
    ----------
    history : PlaneHistory
    numbers : WallNumbers
        Who is who to begin with.
    path : (i, 4, 4) float64
        ``T_map_robot`` to begin with; NaN where there is none.
    moving : (p,) bool
        Plane tracks that say nothing, for they move.

    Returns
    -------
    (assembled, numbers) or None
        None where no iteration has a pose.
    """
    first = assemble(history, numbers, path, moving)
    if first is None:
        return None
    best = refined(first, WIDELY)
    for rounds, times in ((WIDELY, CLOSED), (ROUGHLY, JOINED)):
        for _ in range(times):
            if rounds is WIDELY:
                joined = join_pairs(best, numbers, walls_seen_again(best, history))
            else:
                joined = join_walls(best, numbers)
            if joined.same_as(numbers):
                break
            numbers = joined
            again = assemble(history, numbers, path_of(best, history), moving)
            best = best if again is None else refined(again, rounds)
    return refined_to_the_noise(best), numbers


def path_of(assembled: Assembled, history: PlaneHistory) -> NDArray[np.float64]:
    """Return ``T_map_robot`` (i, 4, 4) by a refined map, else by the motion since."""
    poses = assembled.poses(len(history.motion))
    return stitched([without_strays(poses, history.motion)], history.motion)
