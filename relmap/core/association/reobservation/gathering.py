"""Landmarks of a solved map with odometry that belong to the same object.

An object that is rarely detected has many tracks of few observations, and one whose shape
differs from side to side has several landmarks next to each other.  No scan shows two of them.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.state.table import NONE

SPACING = 0.2
"""Largest distance between two landmarks of one object, in spacings of the landmarks: at random 3 %
of the landmarks in the plane have another one as close."""
DEVIATIONS = 12.5
"""The same in standard deviations of an observation: objects look different from each side."""


def gathered(
    places: Floats, counts: Ints, iterations: list[Ints], noise_m: float, spacing_m: float
) -> Ints:
    """Return for each landmark (n,) the one of the same object; its own number if there is none.

    Each is joined to the nearest that was seen more often (Rodriguez and Laio, 2014), unless a scan
    shows it together with a landmark already joined to that.

    `places` (n, d), metres: median position of the observations of each landmark; `counts` (n,):
    number of observations of each; `iterations`, list of n (k,): the scans that contain each;
    `noise_m`: standard deviation of an observed coordinate; `spacing_m`: median distance from a
    mapped landmark to the nearest other.
    """
    n, reach_m = len(places), min(DEVIATIONS * noise_m, SPACING * spacing_m)
    whole = np.arange(n)
    rank = np.empty(n, dtype=np.int64)
    rank[np.argsort(-counts, kind="stable")] = np.arange(n)
    towards = np.full(n, NONE)
    near = cKDTree(places).query_pairs(reach_m, output_type="ndarray").reshape(-1, 2)
    near = np.concatenate([near, near[:, ::-1]])
    near = near[rank[near[:, 1]] < rank[near[:, 0]]]
    apart = np.linalg.norm(places[near[:, 0]] - places[near[:, 1]], axis=1)
    for piece, other in near[np.argsort(-apart, kind="stable")].tolist():
        towards[piece] = other
    seen = [set(scans.tolist()) for scans in iterations]
    for piece in np.argsort(rank)[towards[np.argsort(rank)] != NONE].tolist():
        of = int(whole[towards[piece]])
        is_near = np.linalg.norm(places[piece] - places[of]) <= reach_m
        if is_near and seen[of].isdisjoint(seen[piece]):
            whole[piece] = of
            seen[of] |= seen[piece]
    return whole
