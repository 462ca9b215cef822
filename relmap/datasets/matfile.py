"""MATLAB files, which may be damaged or no MATLAB files at all."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import quoted, shown

_MAGIC = b"MATLAB 5.0 MAT-file"


def is_matlab(path: Path) -> bool:
    """Tell from its first bytes whether a file is a MATLAB file."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


def read_matrix(file: Path, name: str) -> NDArray[np.float64]:
    """Return a matrix of real numbers from a MATLAB file.

    Raises
    ------
    RelmapError
        Where the file is missing or damaged, or holds no such matrix.
    """
    from scipy.io import loadmat

    try:
        content = loadmat(os.fspath(file), appendmat=False, variable_names=[name])
        matrix = content[name]
        if matrix.dtype.kind not in "fiu" or matrix.ndim != 2 or not matrix.size:
            raise TypeError(f"not a matrix of numbers: {matrix.dtype} {matrix.shape}")
        return np.asarray(matrix, dtype=np.float64)
    except Exception as error:  # a damaged file makes loadmat raise almost anything
        reason = quoted(f"{type(error).__name__}: {error}")
        raise RelmapError(
            f"{shown(file)}: cannot be read: {reason}, expected a MATLAB file with {name}"
        ) from error
