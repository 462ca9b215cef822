"""A folder of depth images: 16-bit PNG files and the intrinsics of the camera.

The format of 7-Scenes (J. Shotton et al., CVPR 2013): ``frame-000000.depth.png`` and so on, in
millimetres, 0 and 65535 without a reading; ``camera-intrinsics.txt``, the 3x3 matrix K of the
camera; and, for comparison, ``frame-000000.pose.txt``, the matrix T_reference_camera. The images
are sorted by the numbers in their names. The camera looks along z, with x to the right and y down;
the points are returned with x ahead, y left and z up, one per two by two pixels.
"""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.headers import numbered_files
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import ScanLog, require_rotations
from relmap.datasets.textfile import invalid, unreadable

INTRINSICS, DEPTH, POSE = "camera-intrinsics.txt", ".depth.png", ".pose.txt"
_DEPTH = re.compile(re.escape(DEPTH) + "$")
UNIT_M, NO_READING = 1e-3, (0, 65535)
EVERY = 2
"""Subsampling of rows and columns of pixels."""
MOST_PIXELS = 1 << 24
DAMAGE = (OSError, ValueError, SyntaxError, EOFError, MemoryError, OverflowError, struct.error)
"""Exceptions of the decoder on damaged images."""
T_CAMERA_ROBOT = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class DepthImages:
    """Reads a folder of depth images."""

    name = "depth-images"
    description = f"a folder of *{DEPTH}"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a folder of depth images."""
        of_camera = os.path.isdir(path) and (path / INTRINSICS).is_file()
        return of_camera and bool(numbered_files(path, _DEPTH))

    def load(self, path: Path) -> ScanLog:
        """Read the log; images are read lazily."""
        files = numbered_files(path, _DEPTH) if os.path.isdir(path) else []
        if not files:
            raise invalid(path, f"holds no *{DEPTH}, expected {self.description}")
        K = read_intrinsics(path)
        stamps_s = np.arange(len(files), dtype=np.float64)
        return ScanLog(3, stamps_s, lambda index: points_of(files[index], K), _poses(files))


def read_intrinsics(folder: Path) -> Floats:
    """Return the matrix K (3, 3) of the camera of a folder, pixels; RelmapError if it is none."""
    file = folder / INTRINSICS
    K = _matrix(file, 3)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise invalid(file, "expected focal lengths above 0")
    if K[1, 0] or (K[2] != [0, 0, 1]).any():
        raise invalid(file, "expected rows fx s cx, 0 fy cy, 0 0 1")
    return K


def points_of(file: Path, K: Floats, unit_m: float = UNIT_M) -> Floats:
    """Return the points (n, 3) of an image, metres, robot frame; `unit_m`: depth of a value of 1.

    `K` (3, 3), pixels. Raises RelmapError if it is not a depth image.
    """
    from PIL import Image  # installed with matplotlib

    try:
        with Image.open(file) as image:
            if image.width * image.height > MOST_PIXELS:
                raise invalid(file, f"more than {MOST_PIXELS} pixels")
            depth = np.asarray(image)[::EVERY, ::EVERY]
    except (*DAMAGE, Image.DecompressionBombError) as error:
        raise unreadable(file, error) from error
    if depth.ndim != 2 or depth.dtype.itemsize < 2:
        raise invalid(file, "is not a depth image, expected one channel of 16 bits")
    row, column = np.nonzero(~np.isin(depth, NO_READING))
    z = depth[row, column] * unit_m
    right = (EVERY * column - K[0, 2]) / K[0, 0] * z
    down = (EVERY * row - K[1, 2]) / K[1, 1] * z
    return np.column_stack([z, -right, -down])


def _poses(files: list[Path]) -> Floats | None:
    """Return T_reference_robot (k, 4, 4); None if an image has no pose."""
    each = [file.with_name(file.name.removesuffix(DEPTH) + POSE) for file in files]
    if not all(file.is_file() for file in each):
        return None
    poses = []
    for file in each:
        poses.append(_matrix(file, 4))
        if (poses[-1][3] != [0, 0, 0, 1]).any():
            raise invalid(file, "the last row is not 0 0 0 1, expected a pose")
        require_rotations(file, poses[-1][None])
    return np.asarray(np.array(poses) @ T_CAMERA_ROBOT)


def _matrix(file: Path, size: int) -> Floats:
    expected = f"{size} numbers: a row of a {size} x {size} matrix"
    rows = read_rows(file, [MAX_COORDINATE_M] * size, "row", expected).values
    if len(rows) != size:
        raise invalid(file, f"{len(rows)} rows, expected a {size} x {size} matrix")
    return rows
