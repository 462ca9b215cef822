"""A folder of depth images in the layout of TUM RGB-D (J. Sturm et al., IROS 2012).

``depth.txt`` has a line ``time depth/name.png`` for each image. Without it, ``associations.txt`` is
read, which has the times and names of colour and depth images in either order, as in ICL-NUIM.
Depths are 16-bit PNG files, 5000 a metre, 0 without a reading. ``groundtruth.txt``, lines
``t x y z qx qy qz qw``, are reference poses of the camera, interpolated at the times of the images.

The intrinsics are those of ``camera-intrinsics.txt`` if there is such a file. Otherwise they are
the published ones of the camera of freiburg1, freiburg2 or freiburg3, if the name of the folder has
one of these words, and else those that the data set recommends for any of its cameras, with a
warning.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.datasets.depth_images import INTRINSICS, T_CAMERA_ROBOT, points_of, read_intrinsics
from relmap.datasets.number_rows import finite_numbers
from relmap.datasets.odometry import poses_at, read_tum
from relmap.datasets.scans import ScanLog, sorted_by_time
from relmap.datasets.textfile import invalid, numbered_lines, quoted, warn

LISTS = ("depth.txt", "associations.txt", "association.txt", "associate.txt")
"""Files that list the images; the first one found is read."""
DEPTH, TRUTH = "depth/", "groundtruth.txt"
UNIT_M = 1 / 5000
PUBLISHED = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""Focal lengths fx, fy and centre cx, cy of the cameras, pixels."""
RECOMMENDED = (525.0, 525.0, 319.5, 239.5)


class TumRgbd:
    """Reads a folder of depth images in the layout of TUM RGB-D."""

    name = "tum-rgbd"
    description = "a folder with depth.txt"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a folder with a list of images in ``depth``."""
        return (path / DEPTH).is_dir() and _list_of(path) is not None

    def load(self, path: Path) -> ScanLog:
        """Read the log; images are read lazily."""
        file = _list_of(path)
        if file is None:
            raise invalid(path, f"holds no {LISTS[0]} or {LISTS[1]}, expected {self.description}")
        stamps_s, names = _images(file)
        K = _intrinsics(path)
        poses = _poses(path / TRUTH, stamps_s)
        log = ScanLog(3, stamps_s, lambda index: points_of(path / names[index], K, UNIT_M), poses)
        return sorted_by_time(path, log, stamps_s)


def _list_of(path: Path) -> Path | None:
    return next((path / name for name in LISTS if (path / name).is_file()), None)


def _images(file: Path) -> tuple[Floats, list[str]]:
    """Return the time (n,), seconds, and the name of each depth image of a list."""
    stamps_s, names = [], []
    for number, line in numbered_lines(file):
        cells = line.partition("#")[0].split()
        if not cells:
            continue
        name = next((cell for cell in cells[1::2] if cell.startswith(DEPTH)), None)
        time = finite_numbers(cells[: cells.index(name)][-1:]) if name else []
        if name is None or not time or ".." in name:
            expected = f"a time and a name {DEPTH}*.png, also beside those of a colour image"
            raise invalid(file, f"line {number}: {quoted(line)}, expected {expected}")
        stamps_s += time
        names.append(name)
    if not names:
        raise invalid(file, f"lists no image, expected lines of a time and {DEPTH}*.png")
    return np.array(stamps_s), names


def _intrinsics(path: Path) -> Floats:
    """Return the matrix K (3, 3) of the camera."""
    if (path / INTRINSICS).is_file():
        return read_intrinsics(path)
    name = path.resolve().name
    known = next((each for word, each in PUBLISHED.items() if word in name), None)
    if known is None:
        used = "the intrinsics of the camera are unknown, those recommended by TUM RGB-D are used"
        warn(path, f"{used}; if they differ, write {INTRINSICS}")
    fx, fy, cx, cy = known or RECOMMENDED
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _poses(file: Path, at_s: Floats) -> Floats | None:
    """Return T_reference_robot (k, 4, 4) at times (k,), NaN if unknown; None without a file."""
    if not file.is_file():
        return None
    stamps_s, poses, _ = read_tum(file)
    order = np.argsort(stamps_s, kind="stable")
    order = order[np.diff(stamps_s[order], prepend=-np.inf) > 0]
    found = poses_at(stamps_s[order], poses[order], at_s)
    return np.asarray(found @ T_CAMERA_ROBOT)
