"""`Plane3dMapper`: planes of any direction, and a sensor with six degrees of freedom."""

from __future__ import annotations

import itertools
from functools import partial
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.core.guard import reads_whole
from relmap.core.linalg.threads import one_thread
from relmap.io.journal import RecordedScan
from relmap.planes3d.edges import at_edges
from relmap.planes3d.files import checked_patches, journaled, of_journal
from relmap.planes3d.hypotheses import Held
from relmap.planes3d.mapped import Mapped3d
from relmap.planes3d.misled import quick_step_m
from relmap.planes3d.placing import Placed, place
from relmap.planes3d.refining import refined, unsure_steps
from relmap.planes3d.sights import (
    is_doubtful,
    is_tied_doubtfully,
    sights_of,
    with_ends,
    with_rim,
)
from relmap.planes3d.steadiness import predicted
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import Patches, PatchSegmenter

Span = tuple[int, int]
LEAST_SCANS, MOST_TIED = 3, 12
"""Minimum number of scans of a submap that is tied, and number of submaps tried, the largest."""


@reads_whole("update", "finish", "refine")
class Plane3dMapper(Mapped3d):
    """Maps planes of any direction with a carried lidar or depth camera, in six degrees of freedom.

    A scan is placed among the planes of the previous scans by what does not depend on the motion:
    the angles between planes, the distances of parallel planes, and the points where three meet.
    Of motions that fit equally well the one closest to the usual step is taken. If no placement is
    accepted, a new submap begins.

    Parameters
    ----------
    segmenter : PatchSegmenter, optional
        Finds the planes of a cloud; default settings if omitted.
    max_missed : int
        A plane that was not seen in more than this many scans is not matched in the next one.
    journal : path, optional
        A new file that records the planes of every scan, so that `resume` can continue from it.
    run : dict, optional
        Description of the run to store in the journal.

    Raises
    ------
    RelmapError
        If `max_missed` is less than 1, or the journal exists or cannot be written.

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

    _variant = "planes3d"

    STATE = "submaps=_submaps _n_iterations _n_planes _refined_at numbers=_name"

    def __init__(
        self,
        segmenter: PatchSegmenter | None = None,
        max_missed: int = 10,
        journal: PathLike[str] | str | None = None,
        run: dict[str, Any] | None = None,
    ) -> None:
        if max_missed < 1:
            raise RelmapError(f"max_missed is {max_missed}; it must be at least 1")
        self.segmenter = segmenter or PatchSegmenter()
        self.max_missed = max_missed
        self._submaps, self._name = [], {}
        self._n_iterations = self._n_planes = self._refined_at = 0
        super().__init__(journal, run)

    def update(self, points: ArrayLike | Patches, stamp_s: float | None = None) -> Ints:
        """Add a scan.

        Parameters
        ----------
        points : (n, 3) array, sensor frame, metres; or Patches
            A cloud, or the planes that a `PatchSegmenter` found in it.
        stamp_s : float, optional
            Time of the scan, seconds, later than that of earlier scans; kept for the trajectory.

        Returns
        -------
        (m,) int64
            Landmark of each patch; `landmarks_of` gives its current number.

        Raises
        ------
        RelmapError
            If the scan is invalid; the mapper is unchanged.
        """
        seen = checked_patches(points if isinstance(points, Patches) else self._segmented(points))
        with self._guard.change():
            time_s = None if stamp_s is None else self._stamps.checked(stamp_s)
            if self._journal is not None:
                self._journal.ready()
            labels = self._take_in(seen)
            self._stamps.append(time_s, self._n_iterations - 1)
            if self._journal is not None:
                values, cells = journaled(seen)
                self._journal.append(RecordedScan(values, None, labels, blob=cells, stamp_s=time_s))
            return labels

    def _segmented(self, points: ArrayLike) -> Patches:
        # The segmenter stores its result: two threads would mix theirs.
        with self._guard.change(spoils=False):
            return self.segmenter.fit(points).patches_

    def _take_in(self, seen: Patches) -> Ints:
        iteration, self._n_iterations = self._n_iterations, self._n_iterations + 1
        if not len(seen):
            return np.empty(0, dtype=np.int64)
        seen = with_rim(with_ends(seen), iteration)
        pose, number = (np.eye(3), np.zeros(3)), np.full(len(seen), -1)
        placed = self._placed(seen, iteration) if self._submaps else None
        if placed is None:
            self._submaps.append(Submap())
        else:
            pose, number = placed.pose, placed.match
            if placed.free is not None:
                self._submaps[-1].weak[iteration] = placed.R.T @ placed.free
            if placed.is_held:
                self._submaps[-1].held.add(iteration)
        new = number < 0
        number[new] = self._n_planes + np.arange(new.sum())
        self._n_planes += int(new.sum())
        self._submaps[-1].add(iteration, seen, pose, number)
        return number.copy()

    def finish(self) -> None:
        """Tie submaps that share at least five planes in only one way, and find uncertain steps.

        Only the 12 largest submaps of at least three scans are tried. If the tie implies a jump,
        they must share twelve planes, and if they are far apart in time more than six, and most of
        their planes or surfaces. They may see through few of those of the other, less if far apart
        in time.
        """
        failed: set[tuple[Span, Span]] = set()
        with self._guard.change(), one_thread():
            self._note_call("finish")
            while self._tied_two(failed):
                pass
            self._name_unsure()

    def refine(self) -> None:
        """Adjust planes and poses of each submap to all observations by least squares.

        Landmarks that are one surface are joined; `landmarks_of` gives their current numbers.
        Points on no plane form further landmarks where those of several scans lie on one.
        Uncertain steps are found again, see `weak_links`.
        """
        with self._guard.change(), one_thread():
            self._note_call("refine")
            for k, part in enumerate(self._submaps):
                if len(part.iteration) > 1:
                    self._submaps[k], name = refined(part, self._n_planes)
                    self._n_planes = max(self._n_planes, int(self._submaps[k].number.max()) + 1)
                    self._rename(name)
            self._refined_at = self._n_iterations
            self._name_unsure()

    @property
    def _configuration(self) -> dict[str, Any]:
        return self.settings

    @classmethod
    def _configured(cls, configuration: Any) -> Self:
        try:
            settings = dict(configuration)
            max_missed = settings.pop("max_missed")
            return cls(PatchSegmenter(**settings), max_missed)
        except (TypeError, LookupError, ValueError) as error:
            raise RelmapError(f"{configuration!s:.80} are not settings of planes3d") from error

    @property
    def _parts(self) -> list[Any]:
        self._guard.check()
        return [self._stamps, self]

    def _again(self, scan: RecordedScan) -> Ints:
        return self.update(of_journal(scan.values, scan.blob), scan.stamp_s)

    def _name_unsure(self) -> None:
        """Find the uncertain steps of all submaps, and what moved away."""
        is_broken, quick_m = len(self._submaps) > 1, quick_step_m(self._submaps)
        for part in self._submaps:
            part.sights = sights_of(part)
            several = len(part.iteration) > 1
            part.unsure = unsure_steps(part, is_broken, quick_m) if several else {}

    def _placed(self, seen: Patches, iteration: int) -> Placed | None:
        """Return the placement of a scan in the last submap; its matches are landmark numbers."""
        part = self._submaps[-1]
        chosen = np.flatnonzero(part.last >= iteration - 1 - self.max_missed)
        if not len(chosen):
            return None
        planes, gap = part.planes(chosen), iteration - part.iteration[-1]
        held = predicted(part)
        doubtful = partial(is_doubtful, seen=seen, planes=planes, part=part, gap=gap)
        edges = partial(at_edges, seen=seen, part=part)
        placed = place(seen, planes, part.poses[-1], held, doubtful, edges)
        return None if placed is None else placed.named(part.number[chosen])

    def _tied_two(self, failed: set[tuple[Span, Span]]) -> bool:
        """Tie two submaps, if any two can be tied that did not fail before; return whether."""
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
        """Tie a submap to another if they show the same place; return whether they do."""
        nowhere = Held(np.zeros(3), np.inf)
        placed = place(part.all_planes(), other.all_planes(), None, nowhere)
        if placed is None or is_tied_doubtfully(placed, part, other):
            return False
        match = placed.named(other.number).match.tolist()
        name = {a: b for a, b in zip(part.number.tolist(), match, strict=True) if b >= 0}
        both, self._refined_at = other.joined(part, placed.pose, name), 0
        parts = [each for each in self._submaps if each not in (part, other)]
        # The next scan is added to the last submap: the one that holds the latest scan.
        self._submaps = sorted([*parts, both], key=lambda each: each.iteration[-1])
        self._rename(name)
        return True

    def _rename(self, name: dict[int, int]) -> None:
        self._name = {old: name.get(new, new) for old, new in self._name.items()} | name


def _span(part: Submap) -> Span:
    """Return a key of a submap that changes when it is joined to another."""
    return part.iteration[0], len(part.iteration)
