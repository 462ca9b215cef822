"""Validation of one scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError

FARTHEST_M = 1e9
"""Upper limit of a valid coordinate: larger than the range of any sensor."""

TINY = 1e-30
"""Smaller values are zero: their squares underflow, and divisions by these overflow."""
SMALLEST_M2, LARGEST_M2 = 1e-30, 1e30
"""Limits of a valid variance; beyond them the squares of weighted values overflow."""
ASYMMETRY = 1e-6
"""Allowed asymmetry of a covariance, relative to its largest entry: rounding."""
SINGULAR = 1e-12
"""Smallest allowed ratio of the least to the largest variance: below it, double precision is
exhausted."""


def checked_points(points: ArrayLike, dimension: int) -> Floats:
    """Return the points of one scan as a new array (n, d) float64.

    `points` (n, 2) or (n, 3) of numbers, robot frame, metres: an empty scan may have any width.
    `dimension`: width of earlier scans; 0 if there were none. Raises `RelmapError` if the shape is
    wrong, differs from earlier scans, or a value is not finite.
    """
    array = _floats(points, "points", "an (n, 2) or (n, 3) array of numbers")
    if array.size == 0 and array.ndim in (1, 2):
        return np.empty((0, dimension or 3))
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise RelmapError(f"points has shape {array.shape}; it must be (n, 2) or (n, 3)")
    if dimension and array.shape[1] != dimension:
        raise RelmapError(
            f"points has {array.shape[1]} columns; earlier scans had {dimension}, "
            "and all scans of a map must agree"
        )
    size = np.abs(array)
    # `size.min()` takes several times as long.
    if size.item(size.argmin()) < TINY:  # those that are -0 too: a journal stores only one zero
        array[size < TINY] = 0.0
    if not size.item(size.argmax()) <= FARTHEST_M:
        row = int(np.argmin((np.abs(array) <= FARTHEST_M).all(axis=1)))
        raise RelmapError(
            f"points row {row} is {array[row].tolist()}; it must be finite, in metres, and at most "
            f"{FARTHEST_M:g}"
        )
    return array


def numbers(values: ArrayLike, name: str, wanted: str, least: float = TINY) -> Floats:
    """Return values as a new, contiguous float64 array; those below the least are zero.

    `values`: array of numbers; `name`, `wanted`: name of the argument and the expected value, for
    error messages. Raises `RelmapError` if they are not an array of real numbers, or masked.
    """
    array = _floats(values, name, wanted)
    array[np.abs(array) < least] = 0.0
    return array + 0.0  # -0 becomes 0: a journal stores only one zero


def _floats(values: ArrayLike, name: str, wanted: str) -> Floats:
    """Return values as a new, contiguous float64 array; see `numbers`."""
    refuse_masked(values, name)
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError(f"its type is {array.dtype}")
        return np.array(array, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise RelmapError(f"{name} must be {wanted}: {error}") from error


def refuse_masked(values: ArrayLike, name: str) -> None:
    """Raise an error if values of an array are masked: a mask would be lost."""
    if type(values) is not np.ndarray and np.ma.is_masked(values):
        raise RelmapError(
            f"{name} has masked values; give only those that are valid, as an array without a mask"
        )


def checked_ids(ids: ArrayLike, n_points: int) -> Ints:
    """Return the ids of one scan as an array (n,) int64.

    Raises `RelmapError` if they are not one whole number per point, or a non-negative id is
    duplicated.
    """
    refuse_masked(ids, "ids")
    try:
        array = np.asarray(ids)
    except (TypeError, ValueError, OverflowError) as error:
        raise RelmapError(f"ids must be ({n_points},) whole numbers: {error}") from error
    if array.shape != (n_points,):
        raise RelmapError(f"ids has shape {array.shape}; it must be ({n_points},), one per point")
    if n_points == 0:
        return np.empty(0, dtype=np.int64)
    if array.dtype.kind not in "iu":
        raise RelmapError(f"ids has type {array.dtype}; ids are whole numbers")
    if array.dtype.kind == "u" and array.max() > np.iinfo(np.int64).max:
        raise RelmapError(f"ids holds {array.max()}; the largest id is {np.iinfo(np.int64).max}")
    array = array.astype(np.int64)
    if np.count_nonzero(array[1:] > array[:-1]) < n_points - 1:  # not ascending
        ordered = np.sort(array)
        twice = ordered[1:][(ordered[1:] == ordered[:-1]) & (ordered[1:] >= 0)]
        if len(twice):
            raise RelmapError(f"ids holds {twice[0]} twice; a landmark is seen once in a scan")
    return array


def checked_covariances(
    covariances: ArrayLike, points: Floats, place: str = "row", places: Ints | None = None
) -> Floats:
    """Return the covariances of one scan as a new array (n, d, d) float64, exactly symmetric.

    `covariances` (n, d, d) of numbers, robot frame, square metres; `points` (n, d): the points they
    belong to; `place`, `places` (n,): what messages call a row, and its number. Raises
    `RelmapError` if the shape is wrong, or a matrix is not finite, symmetric, positive definite,
    and within the range of real sensors.
    """
    n, d = points.shape
    shape = f"({n}, {d}, {d})"
    array = numbers(covariances, "covariances", f"a {shape} array of numbers", 0.0)
    if array.size == 0 and n == 0:
        return np.empty((0, d, d))
    if array.shape != (n, d, d):
        raise RelmapError(
            f"covariances has shape {array.shape}; it must be {shape}, one matrix per point"
        )
    places = np.arange(n) if places is None else places
    across = np.swapaxes(array, 1, 2)
    finite = np.asarray(np.isfinite(array).all(axis=(1, 2)))
    _require(finite, array, "finite", place, places)
    size = np.abs(array).max(axis=(1, 2))
    apart = np.asarray(np.abs(array - across).max(axis=(1, 2)))
    _require(apart <= ASYMMETRY * size, array, "symmetric", place, places)
    array = (array + across) / 2
    eigenvalues = np.linalg.eigvalsh(array)
    definite = eigenvalues[:, 0] > SINGULAR * eigenvalues[:, -1]
    _require(definite, array, "positive definite", place, places)
    within = (eigenvalues[:, 0] >= SMALLEST_M2) & (eigenvalues[:, -1] <= LARGEST_M2)
    _require(within, array, f"between {SMALLEST_M2:g} and {LARGEST_M2:g}", place, places)
    return array


def _require(good: Bools, covariances: Floats, what: str, place: str, places: Ints) -> None:
    if not good.all():
        row = int(np.argmin(good))
        raise RelmapError(
            f"covariances {place} {places[row]} is {covariances[row].tolist()}; it must be {what}: "
            "a covariance in square metres"
        )


def checked_labels(labels: ArrayLike, handed_out: Ints) -> Ints:
    """Return labels (n,) as int64 after checking that they are among the known ones (k,).

    The `RelmapError` names the first that is not.
    """
    try:
        array = np.asarray(labels)
    except ValueError as error:
        raise RelmapError(f"labels must be (n,) whole numbers: {error}") from error
    if array.dtype.kind not in "iu" and array.size:
        raise RelmapError(f"labels has type {array.dtype}; labels are whole numbers")
    strange = array[~np.isin(array, handed_out)]
    if len(strange):
        raise RelmapError(f"labels holds {strange[0]}, which no update has returned")
    return array.astype(np.int64)
