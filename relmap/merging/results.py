"""Merging two result folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.association.reobservation.tying import tie_submaps
from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.geometry.motions import transforms
from relmap.core.landmarks import LandmarkTable
from relmap.core.map.globalmap import GlobalMap
from relmap.core.map.lengths import length_ratio_of_maps
from relmap.core.state.table import LandmarkState
from relmap.evaluation.pairing import moved, paired
from relmap.evaluation.summary import by_status
from relmap.io.results import LANDMARKS, PLANES, Result, Tracks, read_names, shifted
from relmap.merging.tables import joined, joined_walls, moved_walls
from relmap.planes.places.submap_ties import RIVAL, WALLS, ends_by_chance
from relmap.planes.places.wall_tie import ACROSS, LEAST_M, coinciding_ends, wall_ties
from relmap.planes.walls.files import PlaneResult, read_any
from relmap.planes.walls.table import PlaneTable
from relmap.recorded import versions

Record = dict[str, Any]
NOTHING = np.empty(0, dtype=np.int64)
OTHER_UNITS = 20.0
"""Ratio of the lengths of their walls above which two maps are not in the same units."""
NEARLY = 0.7
"""Overlap of walls, as a fraction of the longest, of alignments that are compared by the ends of
walls: halves of a building may have more of its outer walls in common after half a turn."""
SIGMAS = 5.0
"""As in `relmap.planes.places.submap_ties`, but no beams judge the alignment."""
Texts = Mapping[int, str] | None


@dataclass(frozen=True, eq=False)
class Merged:
    """A merged map.

    `result`: for walls a `PlaneResult`. Its path is that of the first run, its iterations are those
    of the first run followed by those of the second. It has no tracks, as they belong to two logs.
    `stamps_s` (k,), `poses` (k, 4, 4): the path of the second, in the frame of the first. `names`:
    of the landmarks whose ids in the logs are texts.
    """

    result: Result
    stamps_s: Floats
    poses: Floats
    names: dict[int, str]


def merge_results(one: Path, other: Path) -> Merged:
    """Return the merged map of two result folders, in the frame of the first.

    If a run broke into submaps, only the map is merged. Raises `RelmapError` if a folder is not a
    result, they are of different kinds, or have no unique alignment.
    """
    a, b = (_read(folder) for folder in (one, other))
    walls = isinstance(a, PlaneResult), isinstance(b, PlaneResult)
    if len({(a.planar, walls[0]), (b.planar, walls[1])}) > 1:
        kinds = [
            "walls" if wall else f"points in {'the plane' if of.planar else 'space'}"
            for of, wall in zip((a, b), walls, strict=True)
        ]
        found = f"{one} is a map of {kinds[0]} and {other} of {kinds[1]}"
        raise RelmapError(f"{found}; they must be of one kind")
    if isinstance(a, PlaneResult) and isinstance(b, PlaneResult):
        T, record = _tie_of_walls(a.planes, b.planes, f"{other} and {one}")
    else:
        T, record = _tie_of_points(a, b, f"{other} and {one}")
    record |= {"first": str(one), "second": str(other)}
    texts = read_names(one), read_names(other)
    result, T, names = _joined(a, b, texts, T, record)
    return Merged(result, b.stamps_s, T @ b.poses, names)


def _read(folder: Path) -> Result:
    result = read_any(folder, "merged")
    corners = result.planes.corner if isinstance(result, PlaneResult) else NOTHING
    unknown = np.setdiff1d(corners[corners >= 0], result.landmarks.landmark)
    if len(unknown):
        raise RelmapError(
            f"{folder / PLANES} names the corner {unknown[0]}, which {LANDMARKS} beside it lacks"
        )
    return result


def _joined(
    a: Result, b: Result, texts: tuple[Texts, Texts], T: Floats, record: Record
) -> tuple[Result, Floats, dict[int, str]]:
    """Merge two results, given an approximate alignment of the second; return it refined."""
    (first, end), (begin, last) = map(_span, (a, b))
    shift, planes = end - begin, None
    if isinstance(a, PlaneResult) and isinstance(b, PlaneResult):
        base = int(a.landmarks.landmark.max(initial=-1)) + 1
        label = b.landmarks.landmark + base
        others = shifted(moved_walls(b.planes, T), shift)
        others = replace(others, corner=np.where(others.corner >= 0, others.corner + base, -1))
        planes, corners = joined_walls(a.planes, others)
        mine = positions_of(a.landmarks.landmark, corners[:, 1])
        pairs = np.column_stack([positions_of(label, corners[:, 0]), mine])
        same = Identities(label, pairs, {})
    else:
        T, pairs = _paired(a, b, T)
        same = identities_of(a, b, texts, pairs)
        record["different_ids"] = same.n_apart
        places = (each.landmarks.position[pairs[:, k]] for k, each in ((1, a), (0, b)))
        record["lengths"] = length_ratio_of_maps(*places)
    theirs = replace(_alone(b.landmarks), position=moved(b.landmarks.position, T))
    theirs = shifted(replace(theirs, landmark=same.label), shift)
    table = joined(_alone(a.landmarks), theirs, same.pairs)
    record |= {"T_first_second": T.tolist(), "common_landmarks": len(pairs)}
    tracks = Tracks(NOTHING, NOTHING, NOTHING)
    summary = _summary(a, b, table, record, [first, last + shift])
    result = Result(table, tracks, a.stamps_s, a.poses, summary)
    return result if planes is None else _of_walls(result, planes), T, same.names


def _span(result: Result) -> tuple[int, int]:
    """Return the first iteration that saw anything, and the one after the last."""
    table = result.planes if isinstance(result, PlaneResult) else result.landmarks
    end = int(table.last_iteration.max(initial=-1)) + 1
    return int(table.first_iteration.min(initial=end)), end


def _paired(a: Result, b: Result, T: Floats) -> tuple[Floats, Ints]:
    """Return the alignment of a map of points to another, and the common landmarks' rows (k, 2)."""
    d = 2 if a.planar else 3
    rows = [np.flatnonzero(result.mapped) for result in (b, a)]
    theirs, mine = (r.landmarks.position[k][:, :d] for r, k in zip((b, a), rows, strict=True))
    T, pairs = paired(theirs, mine, T)
    return T, np.column_stack([rows[0][pairs[:, 0]], rows[1][pairs[:, 1]]])


def _tie_of_points(a: Result, b: Result, named: str) -> tuple[Floats, Record]:
    """Return an approximate alignment of the second map, from unambiguous constellations."""
    d = 2 if a.planar else 3
    places = [result.landmarks.position[result.mapped][:, :d] for result in (a, b)]
    n = [len(each) for each in places]
    failed = f"{named} have no unique alignment: no place of one is found in the other"
    if not all(n):
        raise RelmapError(failed)
    state = LandmarkState()
    state.resize(sum(n), 0, d)
    both = GlobalMap(state)
    numbers = np.split(np.arange(sum(n)), n[:1])
    for landmarks, positions in zip(numbers, places, strict=True):
        both.place(both.new_submap(), landmarks, positions, np.ones(len(landmarks)))
    sd = np.concatenate([result.landmarks.sd[result.mapped] for result in (a, b)])
    noise_m = float(np.median(sd[sd > 0])) if (sd > 0).any() else 0.0
    if not any(True for _ in tie_submaps(both, np.sqrt(2) * noise_m)):
        raise RelmapError(failed)
    fits = (fit_rigid(own, state.position[k]) for own, k in zip(places, numbers, strict=True))
    T_both_a, T_both_b = (transforms(*fit) for fit in fits)
    return np.linalg.inv(T_both_a) @ T_both_b, {}


def _tie_of_walls(a: PlaneTable, b: PlaneTable, named: str) -> tuple[Floats, Record]:
    """Return the alignment of the second map in which walls overlap, and most of their ends."""
    ends = [table.ends[table.status == "static"] for table in (b, a)]
    failed = f"{named} have no unique alignment"
    typical_m = [float(np.median(np.hypot(*(w[:, 1] - w[:, 0]).T))) for w in ends if len(w)]
    if len(typical_m) == 2 and max(typical_m) > OTHER_UNITS * min(typical_m):
        raise RelmapError(
            f"{failed}: their walls are {typical_m[0]:.3g} and {typical_m[1]:.3g} m long in the "
            "median; both maps must be in metres"
        )
    ties = wall_ties(*ends)
    if not ties or ties[0].length_m < LEAST_M:
        length_m = ties[0].length_m if ties else 0.0
        raise RelmapError(
            f"{failed}: {length_m:.1f} m of walls overlap at most, expected {LEAST_M:g} m"
        )
    alike = [tie for tie in ties if tie.length_m > NEARLY * ties[0].length_m]
    judged = [(*coinciding_ends(ends[0], ends[1], tie), tie) for tie in alike]
    (walls, places, best), *others = sorted(judged, key=lambda each: -each[1])
    if best.across < ACROSS:
        raise RelmapError(f"{failed}: the walls that they share are parallel")
    if walls < WALLS or places < ends_by_chance(walls, SIGMAS):
        raise RelmapError(
            f"{failed}: {walls} walls coincide, but ends only in {places} places, as by chance"
        )
    if others and others[0][1] > RIVAL * places:
        raise RelmapError(
            f"{failed}: walls end in {places} common places in one alignment, and in "
            f"{others[0][1]} in another"
        )
    rivals_m = [tie.length_m for tie in ties if tie is not best][:1]
    record = {"common_walls_m": best.length_m, "rival_walls_m": rivals_m, "rms_m": best.rms_m}
    return best.matrix, record


def _alone(table: LandmarkTable) -> LandmarkTable:
    """Return a table without rows of other submaps."""
    return replace(table, submap=np.where(table.submap == 0, 0, -1))


def _of_walls(result: Result, planes: PlaneTable) -> PlaneResult:
    wall, end = np.nonzero((planes.corner >= 0) & (planes.status == "static")[:, None])
    table = result.landmarks
    at = np.full((len(table.landmark), 3), np.nan)
    row = positions_of(table.landmark, planes.corner[wall, end])
    at[row] = np.column_stack([planes.ends[wall, end], np.zeros(len(row))])
    there = np.isfinite(at[:, 0])
    gone = ~there & (table.status == "static")
    table = replace(
        table,
        position=at,
        sd=np.where(there, table.sd, np.nan),
        level=np.where(there, table.level, 0),
        status=np.where(gone, "unmapped", table.status),
        submap=np.where(there, 0, -1),
    )
    counts = by_status(planes.status, "planes_") | by_status(table.status, "corners_")
    summary = result.summary | {"counts": counts}
    return PlaneResult(**vars(replace(result, landmarks=table, summary=summary)), planes=planes)


def _summary(
    a: Result, b: Result, table: LandmarkTable, record: Record, scans: list[int]
) -> Record:
    mapped = int(np.isfinite(table.position[:, 0]).sum())
    counts = {"landmarks": len(table.landmark), "mapped": mapped, **by_status(table.status)}
    about = {name: a.summary.get(name) for name in ("variant", "association", "dimensions")}
    if b.summary.get("association") != about["association"]:
        about["association"] = "nearest"
    return about | {"merged": record, "scans": scans, "versions": versions(), "counts": counts}


@dataclass(frozen=True, eq=False)
class Identities:
    """The identities of the landmarks of a merged map.

    `label` (n,): labels of the landmarks of the second map; `pairs` (k, 2): rows of the second and
    of the first that are one landmark, which keeps the label of the first; `names`: the name in the
    logs of each label that has one; `n_apart`: number of ids that mean different landmarks in the
    two maps.
    """

    label: Ints
    pairs: Ints
    names: dict[int, str]
    n_apart: int = 0


def identities_of(a: Result, b: Result, texts: tuple[Texts, Texts], pairs: Ints) -> Identities:
    """Return the identities, given the `pairs` (k, 2) of rows of `b` and `a` in one place.

    Landmarks of the second map keep their ids if both maps have ids, of the same kind, and the id
    is not that of a landmark of the first elsewhere. `texts`: what the ids of each map stand for,
    by label; None if they are numbers.
    """
    firsts, seconds = a.landmarks.landmark, b.landmarks.landmark
    known = all(result.summary.get("association") == "known" for result in (a, b))
    comparable = known and (texts[0] is None) == (texts[1] is None)
    own = _in_first(seconds, *texts) if comparable else np.full(len(seconds), -1)
    mine = positions_of(firsts, own)
    there = ~np.isin(np.arange(len(own)), pairs[:, 0]) & (mine >= 0)
    unplaced = ~(a.mapped[mine] & b.mapped) & ~np.isin(mine, pairs[:, 1])
    same, apart = np.flatnonzero(there & unplaced), there & ~unplaced
    n_other = int((own[pairs[:, 0]] != firsts[pairs[:, 1]]).sum())
    names = dict(texts[0] or {})
    fresh = max([*firsts.tolist(), *own.tolist(), *names], default=-1) + 1 + np.arange(len(own))
    label = np.where(apart | (own < 0), fresh, own)
    pairs = np.concatenate([pairs, np.column_stack([same, mine[same]])])
    rest = np.setdiff1d(np.arange(len(own)), pairs[:, 0])
    for at, number in zip(label[rest].tolist(), seconds[rest].tolist(), strict=True):
        if texts[1] is not None and number in texts[1]:
            names[at] = texts[1][number]
    return Identities(label, pairs, names, int(apart.sum()) + n_other if comparable else 0)


def _in_first(labels: Ints, first: Texts, second: Texts) -> Ints:
    """Return the labels (n,) of the second map as the first has them; -1 if it has no such text."""
    if first is None or second is None:
        return labels
    number = {text: k for k, text in first.items()}
    return np.array([number.get(second.get(k, ""), -1) for k in labels.tolist()], dtype=np.int64)
