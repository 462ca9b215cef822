"""What a mapper accepts as one scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relmap.core.errors import RelmapError


def checked_points(points: ArrayLike, dimension: int) -> NDArray[np.float64]:
    """Return the points of one scan as a new array (n, d) float64.

    Parameters
    ----------
    points : (n, 2) or (n, 3) array of numbers, robot frame, metres
        An empty scan may have any width.
    dimension : int
        Width of the scans before; 0 if nothing was seen yet.

    Raises
    ------
    RelmapError
        Where the shape is wrong, differs from the scans before, or a value is not finite.
    """
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RelmapError(
            f"points must be an (n, 2) or (n, 3) array of numbers: {error}"
        ) from error
    if array.size == 0 and array.ndim in (1, 2):
        return np.empty((0, dimension or 3))
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise RelmapError(f"points has shape {array.shape}; it must be (n, 2) or (n, 3)")
    if dimension and array.shape[1] != dimension:
        raise RelmapError(
            f"points has {array.shape[1]} columns; the scans before had {dimension}, "
            "and one map holds one kind"
        )
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise RelmapError(
            f"points row {row} is {array[row].tolist()}; it must be finite, in metres"
        )
    return array


def checked_ids(ids: ArrayLike, n_points: int) -> NDArray[np.int64]:
    """Return the ids of one scan as an array (n,) int64.

    Raises
    ------
    RelmapError
        Where they are not one whole number per point, or one that is not negative comes twice.
    """
    array = np.asarray(ids)
    if array.shape != (n_points,):
        raise RelmapError(f"ids has shape {array.shape}; it must be ({n_points},), one per point")
    if n_points == 0:
        return np.empty(0, dtype=np.int64)
    if array.dtype.kind not in "iu":
        raise RelmapError(f"ids has type {array.dtype}; ids are whole numbers")
    array = array.astype(np.int64)
    known, counts = np.unique(array[array >= 0], return_counts=True)
    if (counts > 1).any():
        raise RelmapError(
            f"ids holds {known[counts > 1][0]} twice; a landmark is seen once in a scan"
        )
    return array
