"""Where a refined map is weak, as the summary of a run tells it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.refinement.joint import Refined

SHOWN = 5
"""Weakest segments and merges that are listed."""


def weakness(refined: Sequence[Refined], first_iteration: int) -> dict[str, Any] | None:
    """Return what of the map's segments and merges fits it worst, ready for JSON.

    Residuals are in units of what the noise explains: about 1 is as it should be.

    Parameters
    ----------
    refined : sequence of Refined
        The pieces of the map; the largest is told of.
    first_iteration : int
        The log's number of the mapper's first iteration.

    Returns
    -------
    dict or None
        None where nothing was refined.
    """
    if not refined:
        return None
    piece = max(refined, key=lambda piece: len(piece.landmarks))
    segments, merges = piece.segments, piece.merges
    return {
        "converged": all(each.converged for each in refined),
        "noise_m": piece.noise_m,
        "power": piece.power,
        "anchor_iteration": first_iteration + piece.anchor_iteration,
        "segments": len(segments.residual),
        "segment_residual_median": float(np.median(segments.residual)),
        "weakest_segments": [
            {
                "first_iteration": first_iteration + int(segments.first_iteration[row]),
                "residual": float(segments.residual[row]),
                "middle": segments.middle[row].tolist(),
            }
            for row in _largest(segments.residual)
        ],
        "merges": len(merges.residual),
        "weakest_merges": [
            {
                "landmark": int(merges.landmark[row]),
                "seen_again_as": int(merges.track[row]),
                "apart_m": float(merges.apart_m[row]),
                "residual": float(merges.residual[row]),
            }
            for row in _largest(merges.residual)
        ],
    }


def _largest(values: NDArray[np.float64]) -> list[int]:
    rows: list[int] = np.argsort(-values, kind="stable")[:SHOWN].tolist()
    return rows
