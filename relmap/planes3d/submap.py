"""A part of the run in its own frame: scans, observations and landmarks."""

from __future__ import annotations

from dataclasses import replace
from itertools import repeat

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.motions import transforms
from relmap.planes3d.surfaces import MIXED, KnownCells, Points
from relmap.segmentation.space import Patches
from relmap.segmentation.space.patches import reach_of

Pose = tuple[Floats, Floats]
MOST_LOOSE = 20
"""Maximum number of points on no plane that are kept in a cube of half a cell of the map."""


class Submap:
    """Scans that are tied to each other, and the planes that they saw.

    Attributes
    ----------
    iteration : list of int
    poses : list of R (3, 3) and t (3,)
        ``T_submap_robot`` of each of its scans.
    weak : dict of int to (3,) float64
        Iterations whose position planes determined poorly when they were placed, or whose step from
        the scan before they leave open when `refine` begins, and the direction, robot frame.
    held : set of int
        Those of them for which constant motion was assumed in that direction, or edges used.
    unsure : dict of int to (3,) float64
        Iterations whose step from the scan before all observations together determine poorly, and
        the direction, robot frame; set by `finish` and `refine`.
    seen : list of Patches
        Patches of each scan, robot frame, with the cells that it saw first.
    match : list of (m,) int64
        The landmark of each patch of a scan.
    number : (l,) int64
        Number of each landmark in the mapper.
    scatter : (l, 4, 4) float64
        Condensed points of each landmark, submap frame; see `Patches`.
    last : (l,) int64
        Iteration in which each landmark was last seen.
    sights : dict of int to (2,) int64
        For the number of a landmark, how often scans saw one of its cells where it is, and how
        often they saw through one; see `relmap.planes3d.sights`. Set by `finish` and `refine`.
    share : float or None
        Error that the points of an observation have in common, as a fraction of their noise;
        None before it is estimated by refinement.
    """

    iteration: list[int]
    poses: list[Pose]
    weak: dict[int, Floats]
    held: set[int]
    unsure: dict[int, Floats]
    seen: list[Patches]
    match: list[Ints]
    sights: dict[int, Ints]
    share: float | None
    _loose: dict[int, int]

    STATE = (
        "iteration poses weak held unsure seen match number scatter last sights share "
        "_normal _cells _cell_of _loose _rays"
    )

    def __init__(self) -> None:
        self.iteration, self.poses, self.seen, self.match = [], [], [], []
        self.weak, self.held, self.unsure = {}, set(), {}
        self.number = np.empty(0, dtype=np.int64)
        self.scatter = np.empty((0, 4, 4))
        self.last = np.empty(0, dtype=np.int64)
        self.sights, self.share = {}, None
        self._row: dict[int, int] = {}
        self._normal = np.empty((0, 3))
        self._cells = np.empty((0, 3))
        self._cell_of = np.empty(0, dtype=np.int64)
        self._rays = np.empty(0, dtype=np.int64)
        self._known = KnownCells()
        self._loose = {}

    def restored(self) -> None:
        """Make what follows from the state."""
        self._row = {number: row for row, number in enumerate(self.number.tolist())}
        ends = np.cumsum([len(seen.cells) for seen in self.seen])[:-1]
        sizes = [seen.cell_m for seen in self.seen]
        cells = zip(np.split(self._cells, ends), np.split(self._cell_of, ends), sizes, strict=True)
        self._known.fresh([*cells, *self._rims()])

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.last)

    def add(self, iteration: int, seen: Patches, pose: Pose, number: Ints) -> None:
        """Add a scan.

        `seen`: planes of the scan, robot frame; `pose`, R (3, 3) and t (3,): ``T_submap_robot``;
        `number` (m,): number of the landmark of each patch in the mapper.
        """
        R, t = pose
        kept = self._sparse(seen.loose @ R.T + t, seen.cell_m)
        is_new = seen.is_new & self._new_rays(seen, pose)
        # Of some rays only, those that end beside a plane would seem to pass through it.
        rays = slice(len(is_new) if is_new.any() else 0)
        seen = replace(seen, loose=seen.loose[kept], ends=seen.ends[rays], is_new=is_new[rays])
        self.extend([iteration], [seen], [pose], [number])

    def extend(
        self, iteration: list[int], seen: list[Patches], poses: list[Pose], numbers: list[Ints]
    ) -> None:
        """Add scans whose points on no plane are few enough already; see `add`."""
        motions = list(zip(seen, poses, strict=True))
        normal = np.concatenate([each.normal @ R.T for each, (R, _) in motions])
        match, counts = self._rows(np.concatenate(numbers), normal), [len(each) for each in numbers]
        np.add.at(self.scatter, match, np.concatenate([moved(x.scatter, *T) for x, T in motions]))
        np.maximum.at(self.last, match, np.repeat(iteration, counts))
        matches = np.split(match, np.cumsum(counts)[:-1])
        cells = [
            (each.cells @ R.T + t, own[each.cell_patch], each.cell_m)
            for own, (each, (R, t)) in zip(matches, motions, strict=True)
        ]
        rims = [_rim(*each) for each in zip(seen, poses, matches, strict=True)]
        # Cells where a plane was seen before are dropped: memory grows with the map only.
        fresh = self._known.fresh([*cells, *rims])
        fresh, rim = fresh[: len(seen)], fresh[len(seen) :]
        chosen = [(x[rows], of[rows]) for (x, of, _), rows in zip(cells, fresh, strict=True)]
        self._cells = np.concatenate([self._cells, *(x for x, _ in chosen)])
        self._cell_of = np.concatenate([self._cell_of, *(of for _, of in chosen)])
        self.iteration += iteration
        self.poses += poses
        self.match += matches
        self.seen += [
            replace(
                x,
                cells=x.cells[a],
                cell_patch=x.cell_patch[a],
                rim=x.rim[b],
                rim_patch=x.rim_patch[b],
            )
            for x, a, b in zip(seen, fresh, rim, strict=True)
        ]

    def _rows(self, number: Ints, normal: Floats) -> Ints:
        """Return the landmarks of patches (m,), by number; new ones get normals (m, 3)."""
        number, first, at = np.unique(number, return_index=True, return_inverse=True)
        for k in number[np.argsort(first)].tolist():
            self._row.setdefault(k, len(self._row))
        rows = np.array([self._row[k] for k in number.tolist()], dtype=np.int64)
        new = np.sort(first[rows >= len(self)])
        self.number = np.append(self.number, number[at[new]])
        self.scatter = np.concatenate([self.scatter, np.zeros((len(new), 4, 4))])
        self._normal = np.concatenate([self._normal, normal[new]])
        self.last = np.append(self.last, np.zeros(len(new), dtype=np.int64))
        return np.asarray(rows[at])

    @property
    def n_scans(self) -> Ints:
        """How many scans saw each landmark, (l,)."""
        seen = np.concatenate([self.number[:0], *map(np.unique, self.match)])
        return np.bincount(seen, minlength=len(self))

    @property
    def reach_m(self) -> float:
        """Median range of its scans, metres."""
        return float(np.median([seen.reach_m for seen in self.seen]))

    @property
    def spans(self) -> tuple[Ints, Ints]:
        """The first and the last scan that saw each landmark, both (l,), counted from 0."""
        scan = np.repeat(np.arange(len(self.match)), [len(match) for match in self.match])
        seen, (first, last) = np.concatenate(self.match), np.empty((2, len(self)), dtype=np.int64)
        first[seen[::-1]], last[seen] = scan[::-1], scan
        return first, last

    def _rims(self) -> list[Points]:
        return [_rim(*each) for each in zip(self.seen, self.poses, self.match, strict=True)]

    def _sparse(self, points: Floats, cell_m: float) -> Ints:
        """Return which points (n, 3) on no plane lie in cells of the map with few such points."""
        from relmap.planes3d.nearest_kernels import keys_of

        keys = keys_of(points, cell_m / 2)
        key, at, counts = np.unique(keys, return_inverse=True, return_counts=True)
        known = np.fromiter(map(self._loose.get, key.tolist(), repeat(0)), np.int64, len(key))
        rank = np.empty_like(at)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        rank[np.argsort(at, kind="stable")] = np.arange(len(at)) - first
        self._loose.update(
            zip(key.tolist(), np.minimum(known + counts, MOST_LOOSE).tolist(), strict=True)
        )
        return np.flatnonzero(rank < (MOST_LOOSE - known)[at])

    def _new_rays(self, seen: Patches, pose: Pose) -> Bools:
        """Return which rays of a scan do not begin and end in cells of one of the scan before."""
        from relmap.planes3d.nearest_kernels import keys_of

        R, t = pose
        # The first scan is at the origin, which must not be where cells meet.
        origin = keys_of(t[None] + seen.cell_m / 2, seen.cell_m)
        keys = MIXED * keys_of(seen.ends @ R.T + t, seen.cell_m) + origin
        before, self._rays = self._rays, keys
        return ~np.isin(keys, before)

    @property
    def trajectory(self) -> Floats:
        """``T_submap_robot`` of each of its scans, (p, 4, 4)."""
        return np.array([transforms(*pose) for pose in self.poses]).reshape(-1, 4, 4)

    def planes(self, chosen: Ints) -> Patches:
        """Return landmarks (k,), ascending, as patches in the frame of the submap."""
        weight = self.scatter[chosen, 3, 3]
        centre = self.scatter[chosen, :3, 3] / weight[:, None]
        second = self.scatter[chosen, :3, :3] / weight[:, None, None]
        variance, axes = np.linalg.eigh(second - centre[:, :, None] * centre[:, None])
        variance = np.maximum(variance[:, ::-1], 0.0)
        axes = axes.transpose(0, 2, 1)[:, ::-1].copy()
        facing = np.einsum("ij,ij->i", axes[:, 2], self._normal[chosen])
        axes[:, 2] *= np.where(facing < 0, -1.0, 1.0)[:, None]
        axes[:, 0] = np.cross(axes[:, 1], axes[:, 2])
        tilt = weight[:, None] * (variance[:, :2] - variance[:, 2:])
        information = np.column_stack([tilt, weight])
        place = np.full(len(self), -1)
        place[chosen] = np.arange(len(chosen))
        of = place[self._cell_of]
        order = np.argsort(of, kind="stable")
        order = order[of[order] >= 0]
        count = np.bincount(of[order], minlength=len(chosen))
        cells, cell_m = self._cells[order], max((seen.cell_m for seen in self.seen), default=1.0)
        spread = np.sqrt(variance)
        return Patches(
            centre, axes, information, spread, count, cells, of[order], cell_m, reach_of(cells)
        )

    def all_planes(self) -> Patches:
        """Return all landmarks as patches in the frame of the submap, with their rims."""
        rims = self._rims()
        points = np.concatenate([np.empty((0, 3)), *(each for each, *_ in rims)])
        of = np.concatenate([np.empty(0, dtype=np.int64), *(-1 - each for _, each, _ in rims)])
        return replace(self.planes(np.arange(len(self))), rim=points, rim_patch=of)

    def again(self, poses: list[Pose], name: dict[int, int]) -> Submap:
        """Return the submap with other poses, and with landmarks renamed by number."""
        number = np.array([name.get(k, k) for k in self.number.tolist()], dtype=np.int64)
        part = Submap()
        part.extend(self.iteration, self.seen, poses, [number[match] for match in self.match])
        part.take_over(self)
        return part

    def take_over(self, other: Submap) -> None:
        """Copy all but the observations of another submap of the same scans."""
        self.weak, self.held, self.share = dict(other.weak), set(other.held), other.share
        self.unsure, self.sights = dict(other.unsure), dict(other.sights)
        self._loose, self._rays = other._loose, other._rays

    def joined(self, other: Submap, pose: Pose, name: dict[int, int]) -> Submap:
        """Return the submap and another as one, in the frame of the first scan of both.

        `pose`, R (3, 3) and t (3,): pose of the frame of the other; `name`: landmarks of the other
        that are landmarks of this one.
        """
        R, t = pose
        placed = other.again([(R @ S, R @ s + t) for S, s in other.poses], name)
        scans = [
            (part.iteration[k], part, k) for part in (self, placed) for k in range(len(part.poses))
        ]
        scans.sort(key=lambda scan: scan[0])
        _, first, k = scans[0]
        begin, origin = first.poses[k]
        both = Submap()
        for iteration, part, k in scans:
            S, s = part.poses[k]
            there = begin.T @ S, begin.T @ (s - origin)
            both.add(iteration, part.seen[k], there, part.number[part.match[k]])
        both.weak, both.held = self.weak | other.weak, self.held | other.held
        both.unsure = self.unsure | other.unsure
        return both


def _rim(seen: Patches, pose: Pose, match: Ints) -> Points:
    """Return the rim points (r, 3) of a scan, submap frame, their rims, -1 - landmark, and cells.

    `match` (m,): landmark of each patch.
    """
    R, t = pose
    return seen.rim @ R.T + t, -1 - match[seen.rim_patch], seen.cell_m


def moved(scatter: Floats, R: Floats, t: Floats) -> Floats:
    """Return scatters (m, 4, 4) of points after a rigid motion."""
    T = transforms(R, t)
    return np.asarray(T @ scatter @ T.T)
