"""`Plane3dMapper`: planes of any direction, and a sensor that moves with six degrees of freedom."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.scan import checked_labels
from relmap.planes3d.fitting import Surfaces
from relmap.planes3d.hypotheses import Held
from relmap.planes3d.placing import Placed, place
from relmap.planes3d.refining import refined, unsure_steps
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import Plane3dTable, plane_table
from relmap.segmentation.space import Patches, PatchSegmenter

Span = tuple[int, int]
LEAST_SCANS, MOST_TIED = 3, 12
"""Scans of a submap that is tied to others, and how many of the largest are tried."""
SURE = 5
"""Planes in common without which submaps are not tied: three match any others at right angles."""
STEADY = 6
"""Scans whose mean step is gone on with where planes do not tell."""


class Plane3dMapper:
    """Maps planes of any direction with a carried lidar or depth camera, in six degrees of freedom.

    A scan is placed among the planes of the scans before by what no motion changes: the angles
    between planes, the distances of parallel ones, the corners of three.  No motion is estimated
    before.  Where no placement is believed, a submap begins.

    Parameters
    ----------
    segmenter : PatchSegmenter, optional
        What turns points into planes.
    max_missed : int
        A plane unseen for more scans than this is not looked for in the next.

    Examples
    --------
    >>> import numpy as np
    >>> from relmap import Plane3dMapper
    >>> u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 3.0, 60)] * 2))
    >>> sides = [np.insert(np.column_stack([u, v]), axis, 0.0, axis=1) for axis in range(3)]
    >>> corner = np.concatenate(sides)
    >>> mapper = Plane3dMapper()
    >>> for x in np.linspace(1.0, 1.2, 3):
    ...     labels = mapper.update(corner - [x, 1.0, 1.0])
    >>> mapper.finish()
    >>> mapper.trajectory[:, :3, 3].round(6).tolist()
    [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]
    """

    def __init__(self, segmenter: PatchSegmenter | None = None, max_missed: int = 10) -> None:
        if max_missed < 1:
            raise RelmapError(f"max_missed is {max_missed}; it must be at least 1")
        self.segmenter = segmenter or PatchSegmenter()
        self.max_missed = max_missed
        self._parts: list[Submap] = []
        self._n_iterations = self._n_planes = 0
        self._name: dict[int, int] = {}

    def update(self, points: ArrayLike | Patches) -> Ints:
        """Take in one scan.

        Parameters
        ----------
        points : (n, 3) array, sensor frame, metres; or Patches
            A cloud, or what a `PatchSegmenter` found in it.

        Returns
        -------
        (m,) int64
            Number of the plane of each patch; see `landmarks_of`.

        Raises
        ------
        RelmapError
            Where the points cannot be used; the mapper is then as it was.
        """
        seen = points if isinstance(points, Patches) else self.segmenter.fit(points).patches_
        iteration, self._n_iterations = self._n_iterations, self._n_iterations + 1
        if not len(seen):
            return np.empty(0, dtype=np.int64)
        pose, number = (np.eye(3), np.zeros(3)), np.full(len(seen), -1)
        placed = self._placed(seen, iteration) if self._parts else None
        if placed is None:
            self._parts.append(Submap())
        else:
            pose, number = (placed.R, placed.t), placed.match
            if placed.free is not None:
                self._parts[-1].weak[iteration] = placed.R.T @ placed.free
            if placed.is_held:
                self._parts[-1].held.add(iteration)
        new = number < 0
        number[new] = self._n_planes + np.arange(new.sum())
        self._n_planes += int(new.sum())
        self._parts[-1].add(iteration, seen, pose, number)
        return number.copy()

    def finish(self) -> None:
        """Tie submaps that show the same place: five planes at least, and no other way to do so.

        The largest are tried, and none of fewer than three scans.
        """
        failed: set[tuple[Span, Span]] = set()
        while self._tied_two(failed):
            pass
        self._name_unsure()

    def refine(self) -> None:
        """Bring planes and poses to where all observations agree best, in each submap.

        Landmarks that come to lie on one plane and overlap are joined, see `landmarks_of`.
        """
        for k, part in enumerate(self._parts):
            if len(part.iteration) > 1:
                self._parts[k], name = refined(part)
                self._rename(name)
        self._name_unsure()

    def landmarks_of(self, labels: ArrayLike) -> Ints:
        """Return the numbers (n,) that planes, numbered by earlier updates, have now.

        Raises
        ------
        RelmapError
            Where no update has returned such a number.
        """
        checked = checked_labels(labels, np.arange(self._n_planes))
        return np.array([self._name.get(label, label) for label in checked.tolist()], np.int64)

    @property
    def n_iterations(self) -> int:
        """How many scans were taken in, empty ones included."""
        return self._n_iterations

    @property
    def settings(self) -> dict[str, Any]:
        """The settings, by name."""
        chosen = self.segmenter
        return {
            "max_missed": self.max_missed,
            "voxel_m": chosen.voxel_m,
            "min_points": chosen.min_points,
            "most": chosen.most,
        }

    @property
    def submaps(self) -> list[Submap]:
        """The parts of the run that nothing ties to one another, those of most scans first."""
        return sorted(self._parts, key=lambda part: (-len(part.iteration), part.iteration[0]))

    @property
    def planes(self) -> Plane3dTable:
        """Every plane, in the frame of its submap; mapped are those of the first."""
        return plane_table(self.submaps)

    @property
    def trajectory(self) -> Floats:
        """``T_map_sensor`` of every iteration (k, 4, 4); NaN beyond the first submap."""
        poses = np.full((self._n_iterations, 4, 4), np.nan)
        for part in self.submaps[:1]:
            poses[part.iteration] = part.trajectory
        return poses

    @property
    def weak_links(self) -> dict[int, Floats]:
        """The iterations before which too little was seen, and the free direction.

        It is that (3,), in the sensor's frame, in which planes do not tell where the sensor was
        then: it was taken to go on as before.
        """
        found = [part.unsure | part.weak for part in self._parts]
        return {k: free for each in found for k, free in sorted(each.items())}

    def _name_unsure(self) -> None:
        for part in self._parts:
            part.unsure = unsure_steps(part) if len(part.iteration) > 1 else {}

    def _placed(self, seen: Patches, iteration: int) -> Placed | None:
        """Return where a scan lies in the last submap; its matches are numbers of planes."""
        part = self._parts[-1]
        chosen = np.flatnonzero(part.recent(iteration, self.max_missed))
        if not len(chosen):
            return None
        placed = place(seen, Surfaces(part.planes(chosen)), part.poses[-1], _going_on(part))
        return placed and placed.named(part.number[chosen])

    def _tied_two(self, failed: set[tuple[Span, Span]]) -> bool:
        """Tie two submaps; tell whether any could be.  What was tried before is not tried again."""
        large = [part for part in self.submaps if len(part.iteration) >= LEAST_SCANS][:MOST_TIED]
        for other, part in itertools.combinations(large, 2):
            key = _span(other), _span(part)
            if key in failed:
                continue
            if self._tie(part, other):
                return True
            failed.add(key)
        return False

    def _tie(self, part: Submap, other: Submap) -> bool:
        """Tie a submap to another, if it shows the same place; tell whether it does."""
        placed = place(
            part.all_planes(), Surfaces(other.all_planes()), None, Held(np.zeros(3), np.inf)
        )
        if placed is None or placed.free is not None or placed.n_planes < SURE:
            return False
        match = placed.named(other.number).match.tolist()
        name = {a: b for a, b in zip(part.number.tolist(), match, strict=True) if b >= 0}
        both = other.joined(part, (placed.R, placed.t), name)
        parts = [each for each in self._parts if each not in (part, other)]
        # The one whose last scan is the latest goes on with the next.
        self._parts = sorted([*parts, both], key=lambda each: each.iteration[-1])
        self._rename(name)
        return True

    def _rename(self, name: dict[int, int]) -> None:
        self._name = {old: name.get(new, new) for old, new in self._name.items()} | name


def _going_on(part: Submap) -> Held:
    """Return where the next scan is if it goes on as the last ones did."""
    way = np.array([t for _, t in part.poses[-STEADY:]])
    steps = np.diff(way, axis=0)
    known = [k not in part.held for k in part.iteration[-STEADY:]][1:]
    mean = steps.mean(axis=0) if len(steps) else np.zeros(3)
    rms = np.sqrt((steps[known] ** 2).sum(axis=1).mean()) if any(known) else np.inf
    return Held(way[-1] + mean, float(rms))


def _span(part: Submap) -> Span:
    """Return what tells a submap from others, and from itself before it was joined."""
    return part.iteration[0], len(part.iteration)
