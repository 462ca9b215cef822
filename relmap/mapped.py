"""What a mapper has found so far: labels, tables, submaps, groups and the trajectory."""

from __future__ import annotations

from abc import ABC
from collections.abc import Sequence
from html import escape
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from relmap.core import readout
from relmap.core.arrays import Floats, Ints
from relmap.core.config import WITH_IDS, WITH_POINTS, MapperConfig, in_use
from relmap.core.guard import ChangeGuard, reads_whole
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Submap
from relmap.core.mapper import RelativeMapper
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.joint import Refined
from relmap.core.scan import checked_labels
from relmap.core.stamps import Stamps


@reads_whole()
class Mapped(ABC):
    """The results of an engine.

    Attributes
    ----------
    engine : RelativeMapper
        The mapping engine: landmark table, store, schedule and groups, for experiments. Changes
        made there are neither checked nor recorded in the journal.
    """

    config: MapperConfig
    _engine: RelativeMapper
    _guard: ChangeGuard
    _stamps: Stamps
    _unused: ClassVar[dict[str, str]] = WITH_POINTS
    """Settings that the variant ignores, with the reason."""

    @property
    def engine(self) -> RelativeMapper:
        """The mapping engine, see above.

        Raises
        ------
        RelmapError
            If an update was interrupted, or another thread is running one.
        """
        self._guard.check()
        return self._engine

    def landmarks_of(self, labels: ArrayLike) -> Ints:
        """Return the current labels of landmarks (of walls: their numbers), given earlier ones.

        A landmark that is lost and seen again gets a new label, until it is recognised.

        Parameters
        ----------
        labels : (n,) array of int
            As returned by `update`; -1, of an unidentified point, is returned as -1.

        Returns
        -------
        (n,) int64

        Raises
        ------
        RelmapError
            If no update has returned such a label.
        """
        return self._current(labels)

    def _current(self, labels: ArrayLike) -> Ints:
        labels = checked_labels(labels, np.append(readout.labels(self.engine), -1))
        if self.engine.association.has_ids:
            return labels
        return np.where(labels >= 0, self.engine.table.landmark_of[labels], labels)

    @property
    def settings(self) -> dict[str, Any]:
        """The settings in effect, by name."""
        is_known = self.engine.association.is_known
        return in_use(self.config, WITH_IDS if is_known else self._unused)

    @property
    def n_iterations(self) -> int:
        """Number of scans processed, empty ones included."""
        return self.engine.store.n_iterations

    @property
    def map(self) -> LandmarkMap:
        """The mapped landmarks, in ascending order of their labels."""
        return readout.landmark_map(self.engine)

    @property
    def landmarks(self) -> LandmarkTable:
        """Every landmark ever seen, mapped or not."""
        return readout.landmark_table(self.engine)

    @property
    def submaps(self) -> Sequence[Submap]:
        """The submaps; more than one if parts of the run are not connected.

        The largest is first, or the map to which a log was added.
        """
        return readout.map_submaps(self.engine)

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the map, in the order in which they were placed."""
        return readout.mapped_groups(self.engine)

    @property
    def refined(self) -> list[Refined]:
        """The submaps as refined, in the order of `submaps`; none after a later update.

        They include the residuals of each segment of the run and of each merge. Landmarks are
        identified by their index, in order of first observation.
        """
        ranks = self.engine.map.ranks
        return sorted(self.engine.refined, key=lambda one: int(ranks[one.landmarks].max(initial=0)))

    @property
    def rejected(self) -> Ints:
        """Iterations (r,), ascending, whose scans match no other scan and do not enter the map."""
        return self.engine.association.rejected

    @property
    def tied_share(self) -> float | None:
        """Fraction of scans, of points without ids, that were matched to the tracks at once.

        The others began new tracks, and possibly new submaps. Rival placements are searched for
        only where nearest neighbours do not agree, so this does not show that the matches are
        correct. Empty scans do not count; None with known association, for walls, for other
        registrations, and with fewer than two scans that show any point.
        """
        return self.engine.association.current.tied_share

    @property
    def unique_share(self) -> float | None:
        """Fraction of scans whose matches exceed what chance produces in any placement.

        None where `tied_share` is. It does not reveal perceptual aliasing.
        """
        return self.engine.association.current.unique_share

    @property
    def n_undone(self) -> int:
        """Number of merges undone because the refined map contradicted them."""
        return self.engine.merger.n_undone

    @property
    def odometry(self) -> OdometryUse | None:
        """How odometry was used by the last `finish` or `refine`; None if there was none."""
        return self.engine.odometry

    @property
    def trajectory(self) -> Floats:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN where undetermined."""
        return readout.path(self.engine)

    @property
    def paths(self) -> list[tuple[Ints, Floats]]:
        """Of each of the `submaps`: the iterations (p,) with a pose in it, and these (p, 4, 4).

        The poses are ``T_submap_robot``. A scan that shows points of two submaps has one in both.
        """
        return readout.paths(self.engine)

    @property
    def stamps_s(self) -> Floats:
        """Time of each iteration (k,), seconds, as given to `update`; NaN where none was given."""
        return self._stamps.of(self.n_iterations)

    @property
    def noise_m(self) -> float:
        """Estimated standard deviation of an observed coordinate, metres; NaN if unknown."""
        return float(self.engine.noise_m)

    def __repr__(self) -> str:
        mapped = self.map
        text = f"{self.n_iterations} iterations, {len(mapped)} landmarks mapped"
        if len(mapped):
            low, high = mapped.positions.min(axis=0), mapped.positions.max(axis=0)
            extent = " x ".join(f"{size:.4g}" for size in np.subtract(high, low) if size > 0)
            text += f", {extent} m" if extent else ""
        return f"{type(self).__name__}({text})"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.map.to_html()}"
