"""A submap refined: plane adjustment, and landmarks that turn out to be one plane joined."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes3d.adjustment import PlaneAdjustment, Scene, Sightings, systematic_share
from relmap.planes3d.fitting import SIDE, SYSTEMATIC, Surfaces, distances, overlapping
from relmap.planes3d.submap import Submap

ROUNDS = 4
"""How often landmarks are joined and all is solved again, at most."""
ONE = 2.0
"""How far apart two landmarks that are one plane may lie, in deviations of their points."""


def refined(part: Submap) -> tuple[Submap, dict[int, int]]:
    """Return a submap on which all observations agree best.

    Returns
    -------
    part : Submap
    name : dict of int to int
        Landmarks that turned out to be others.
    """
    names: dict[int, int] = {}
    for round_ in range(ROUNDS):
        part = _adjusted(part)
        doubles = _doubles(part)
        if not doubles or round_ == ROUNDS - 1:
            return part, names
        part = part.again(part.poses, doubles)
        names = {old: doubles.get(new, new) for old, new in names.items()} | doubles
    return part, names


def sightings(part: Submap) -> Sightings:
    """Return what was seen of a submap's planes, by all its scans that saw any."""
    scan = np.concatenate([np.full(len(seen), k) for k, seen in enumerate(part.seen)])
    columns = [
        np.concatenate([getattr(seen, name) for seen in part.seen])
        for name in ("centre", "axes", "information", "spread")
    ]
    return Sightings(scan, np.concatenate(part.match), *columns)


def scene(part: Submap) -> Scene:
    """Return poses and planes as they are."""
    planes = part.all_planes()
    R, t = (np.array(each) for each in zip(*part.poses, strict=True))
    return Scene(R, t, planes.normal.copy(), planes.centre, np.zeros(len(part)))


def _adjusted(part: Submap) -> Submap:
    seen, state = sightings(part), scene(part)
    share = SYSTEMATIC if part.share is None else part.share
    free = {part.iteration.index(k): part.weak[k] for k in sorted(part.weak)}
    state = PlaneAdjustment(seen, share, free).solve(state)
    share = systematic_share(seen, state)
    state = PlaneAdjustment(seen, share, free).solve(state)
    again = part.again(list(zip(state.R, state.t, strict=True)), {})
    again.share = share
    return again


def _doubles(part: Submap) -> dict[int, int]:
    """Return which landmarks are others, of lower number, by number."""
    planes = part.all_planes()
    still, origin = np.eye(3), np.zeros(3)
    off = distances(still, origin, planes, planes)
    noise = np.hypot(planes.spread[:, None, 2], planes.spread[:, 2])
    one = (off < ONE * noise) & (planes.normal @ planes.normal.T > SIDE)
    one &= overlapping(still, origin, planes, Surfaces(planes))
    # The smaller of two must lie on the larger; from the larger's ends the smaller's plane strays.
    size = _sizes(planes.cell_patch, len(planes))
    a, b = np.nonzero(one & (size[:, None] <= size) & ~np.eye(len(planes), dtype=bool))
    name: dict[int, int] = {}
    for k in np.argsort(off[a, b] / noise[a, b], kind="stable").tolist():
        pair = sorted((int(part.number[a[k]]), int(part.number[b[k]])))
        # One at a time: what is joined is looked at again in the next round.
        if not any(number in name or number in name.values() for number in pair):
            name[pair[1]] = pair[0]
    return name


def _sizes(of: Ints, count: int) -> Floats:
    return np.bincount(of, minlength=count).astype(np.float64)
