"""What a map of walls is compared with: true walls, the path of a log, or checked relations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets import Relations, open_scans
from relmap.datasets.textfile import require_path, shown
from relmap.evaluation.plane_evaluate import WallTruth, read_wall_truth
from relmap.evaluation.plane_relations import RELATIONS, relations_by_clocks
from relmap.evaluation.truth import refuse_result


def read_plane_truth(path: Path) -> WallTruth:
    """Read what there is to compare with.

    Parameters
    ----------
    path : Path
        One of

        * a folder with ``truth/planes.csv`` or ``planes.csv``, as `relmap simulate` writes it;
        * a log of point scans, for the poses that it gives: a reference, or exact if simulated;
        * a ``.relations`` file, of pairs of poses that were checked by hand.  Its times are the
          robot's; a CARMEN log of the same name beside it tells the logger's times too.

    Raises
    ------
    RelmapError
        Where it is none of these or is damaged.
    """
    require_path(path)
    if path.name.endswith(RELATIONS):
        return path_truth(relations=relations_by_clocks(path))
    if (path / "truth").is_dir():
        return read_wall_truth(path)
    refuse_result(path)
    if (path / "planes.csv").is_file():
        return read_wall_truth(path)
    try:
        log = open_scans(path)
    except RelmapError as error:
        expected = f"truth/planes.csv, a log of point scans or a {RELATIONS} file"
        raise RelmapError(f"{error}; to compare walls with, expected {expected}") from error
    if log.poses is None:
        raise RelmapError(f"{shown(path)}: the log gives no poses, expected one that does")
    return path_truth(log.stamps_s, log.poses)


def path_truth(
    stamps_s: NDArray[np.float64] | None = None,
    poses: NDArray[np.float64] | None = None,
    relations: tuple[Relations, ...] = (),
) -> WallTruth:
    """Return a truth without walls."""
    return WallTruth(
        np.empty((0, 2, 2)),
        np.empty((0, 2), dtype=np.int64),
        np.empty(0) if stamps_s is None else stamps_s,
        np.empty((0, 4, 4)) if poses is None else poses,
        relations,
    )
