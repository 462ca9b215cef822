"""Patches as a journal holds them.

The columns of a patch are those of `relmap.io.journal.layout`. ``cells`` has numbers of 8 bytes,
little-endian: `cell_m`, `reach_m`, the number of cells, `cells` and `cell_patch`, the latter a
whole number, and `loose`, all as in `relmap.segmentation.space.Patches`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.segmentation.space import Patches

ARRAYS = ("centre", "axes", "information", "spread", "cells", "loose")


def checked_patches(seen: Patches) -> Patches:
    """Return patches as a journal restores them: contiguous, 0 for -0; RelmapError if invalid."""
    arrays: dict[str, Any] = {
        name: np.ascontiguousarray(getattr(seen, name), dtype=np.float64) + 0.0 for name in ARRAYS
    }
    wrong = next((name for name, array in arrays.items() if not np.isfinite(array).all()), None)
    if wrong is not None:
        raise RelmapError(f"{wrong} of the patches has a number that is not finite")
    if not (arrays["information"][:, 2] > 0).all():
        raise RelmapError("information of the patches must be above 0 for the distance")
    whole = {name: getattr(seen, name).astype(np.int64) for name in ("n_points", "cell_patch")}
    return replace(seen, **arrays, **whole)


def journaled(seen: Patches) -> tuple[Floats, bytes]:
    """Return the columns (m, 19) of checked patches, and the rest."""
    m, about = len(seen), np.array([seen.cell_m, seen.reach_m, len(seen.cells)], dtype="<f8")
    columns = (seen.centre, seen.axes.reshape(m, 9), seen.information, seen.spread, seen.n_points)
    parts = (about, seen.cells, seen.cell_patch.astype("<i8"), seen.loose)
    return np.column_stack(columns), b"".join(part.tobytes() for part in parts)


def of_journal(values: Floats, cells: bytes) -> Patches:
    """Return the patches of a scan in a journal."""
    cell_m, reach_m, count = np.frombuffer(cells[:24], "<f8").tolist()
    c = int(count)
    centre, axes, information, spread, points = np.split(values, (3, 12, 15, 18), axis=1)
    at, of, loose = cells[24 : 24 + 24 * c], cells[24 + 24 * c : 24 + 32 * c], cells[24 + 32 * c :]
    return Patches(
        centre=centre.copy(),
        axes=axes.reshape(-1, 3, 3),
        information=information.copy(),
        spread=spread.copy(),
        n_points=points[:, 0].astype(np.int64),
        cells=np.frombuffer(at, "<f8").reshape(-1, 3),
        cell_patch=np.frombuffer(of, "<i8"),
        cell_m=cell_m,
        reach_m=reach_m,
        loose=np.frombuffer(loose, "<f8").reshape(-1, 3),
    )
