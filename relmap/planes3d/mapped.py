"""What a mapper of planes in space has found so far."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.guard import reads_whole
from relmap.core.scan import checked_labels
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import Plane3dTable, plane_table
from relmap.recorded import Recorded
from relmap.segmentation.space import PatchSegmenter


@reads_whole()
class Mapped3d(Recorded):
    """The results of `Plane3dMapper`."""

    segmenter: PatchSegmenter
    max_missed: int
    _submaps: list[Submap]
    _n_iterations: int
    _n_planes: int
    _refined_at: int
    _name: dict[int, int]

    def landmarks_of(self, labels: ArrayLike) -> Ints:
        """Return the current numbers of landmarks.

        Parameters
        ----------
        labels : (n,) array of int
            Numbers that `update` returned.

        Returns
        -------
        (n,) int64

        Raises
        ------
        RelmapError
            If `update` has not returned one of the numbers.
        """
        self._guard.check()
        checked = checked_labels(labels, np.arange(self._n_planes))
        return np.array([self._name.get(label, label) for label in checked.tolist()], np.int64)

    @property
    def n_iterations(self) -> int:
        """Number of scans, empty ones included."""
        self._guard.check()
        return self._n_iterations

    @property
    def stamps_s(self) -> Floats:
        """Time of each iteration (k,), seconds, as given to `update`; NaN where none was given."""
        return self._stamps.of(self.n_iterations)

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
        """The parts of the run that are not tied to each other, largest number of scans first."""
        self._guard.check()
        return sorted(self._submaps, key=lambda part: (-len(part.iteration), part.iteration[0]))

    @property
    def planes(self) -> Plane3dTable:
        """All planes, each in the frame of its submap; those of the first submap are mapped."""
        return plane_table(self.submaps, self.is_refined)

    @property
    def trajectory(self) -> Floats:
        """``T_map_sensor`` of each iteration (k, 4, 4); NaN outside the first submap."""
        poses = np.full((self._n_iterations, 4, 4), np.nan)
        for part in self.submaps[:1]:
            poses[part.iteration] = part.trajectory
        return poses

    @property
    def is_refined(self) -> bool:
        """Whether the map was refined after the last scan."""
        return 0 < self.n_iterations == self._refined_at

    @property
    def weak_links(self) -> dict[int, Floats]:
        """The iterations whose position is poorly determined, and the direction.

        The direction (3,), sensor frame, is one in which the planes of the scan did not determine
        the position well, so that constant motion may have been assumed, or edges used; or, after
        `finish` or `refine`, one in which the step from the scan before is uncertain.
        """
        self._guard.check()
        found = [part.unsure | part.weak for part in self._submaps]
        return {k: free for each in found for k, free in sorted(each.items())}

    def __repr__(self) -> str:
        mapped = np.sum(self.planes.status == "static")
        return f"{type(self).__name__}({self.n_iterations} iterations, {mapped} planes mapped)"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.planes.to_html()}"
