"""`PlaneMapper`: the engine with the corners of walls as landmarks."""

from __future__ import annotations

import logging
from dataclasses import replace
from os import PathLike
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from relmap.core import afterwards
from relmap.core.arrays import Floats, Ints
from relmap.core.config import WITH_WALLS, MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.guard import reads_whole
from relmap.core.linalg.threads import one_thread
from relmap.core.odometry import checked_odometry
from relmap.core.scan import checked_labels
from relmap.io.journal import RecordedScan
from relmap.planes.places.implied_steps import ImpliedSteps
from relmap.planes.places.map_part import MapPart
from relmap.planes.places.submap_ties import tied_parts
from relmap.planes.refinement.refining import planned_submaps, refined_submaps
from relmap.planes.remapping import RemappingMapper
from relmap.planes.scans.beams import GivenBeams
from relmap.planes.scans.observation import PlaneObservation, checked_planes, journaled, of_journal
from relmap.planes.submaps.contradictions import contradicted_revisits
from relmap.planes.submaps.doubtful import unsupported_links
from relmap.planes.submaps.submap import torn_in

_LOG = logging.getLogger(__name__)

CUTS = 4
"""Maximum number of rounds of cutting torn submaps and refining again."""

BEAMS_PER_M = 100
"""Beams of a submap by which its ties are judged, by the length of its walls: three must support a
stretch."""


class Segmenter(Protocol):
    """Interface for finding planes in points; see `relmap.segmentation.PlaneSegmenter`."""

    planes_: Any

    def fit(self, points: Any) -> Any:
        """Segment one scan, (n, 2) or (n, 3)."""
        ...


@reads_whole("update", "refine")
class PlaneMapper(RemappingMapper):
    """Maps walls in 2½-D: vertical planes, for a robot that moves in the plane.

    Parameters
    ----------
    config : MapperConfig, optional
    segmenter : Segmenter, optional
        Finds planes in points; by default a `relmap.segmentation.PlaneSegmenter`.
    journal : path, optional
        A new file that records the walls of every scan, so that `resume` can continue from it.
    run : dict, optional
        Description of the run to store in the journal.

    Examples
    --------
    >>> import numpy as np
    >>> from types import SimpleNamespace
    >>> from relmap.planes import PlaneMapper
    >>> room = np.array([[[3.0, -2.0], [3.0, 2.0]], [[3.0, 2.0], [-1.0, 2.0]]])
    >>> kind = np.array([["view", "corner"], ["corner", "view"]])
    >>> mapper = PlaneMapper()
    >>> for x in np.linspace(0.0, 0.5, 11):
    ...     walls = mapper.update(SimpleNamespace(ends=room - [x, 0.0], end_type=kind))
    >>> mapper.finish()
    >>> mapper.map.positions.round(6).tolist()
    [[3.0, 2.0, 0.0], [3.0, 2.0, 0.0]]
    """

    _unused = WITH_WALLS
    _variant = "planes"

    STATE = "walls=_planes refined_walls=_refined_walls _moved _frame _onto _n_finished"

    def __init__(
        self,
        config: MapperConfig | None = None,
        segmenter: Segmenter | None = None,
        journal: PathLike[str] | str | None = None,
        run: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(config, journal, run)
        self._connect()
        self._segmenter = segmenter
        self._refined_walls = None
        self._moved, self._frame = np.empty(0, dtype=np.int64), None
        self._n_finished = 0

    def update(
        self,
        points: Any,
        ids: ArrayLike | None = None,
        beams: ArrayLike | None = None,
        odometry: ArrayLike | None = None,
        stamp_s: float | None = None,
    ) -> Ints:
        """Process one iteration.

        Parameters
        ----------
        points : (n, 2) or (n, 3) array, robot frame, metres; or planes
            Points of a scan, or segmented planes: any object with `ends` and `end_type` like
            `relmap.segmentation.Planes`. If an `end_type` is "unknown" or missing, static ends are
            detected over time (Fig. 4).
        ids : None
            Walls have no known association.
        beams : (n, 2) or (n, 3) array, robot frame, metres, optional
            End points of the beams of the scan; by default the points, if given. Beams of a 2-D
            laser, (n, 2), verify the motion of the robot; those of a cloud only mark free space.
            The sensor is at the `origin` (2,) of the planes, if they have one.
        odometry : (3,), (7,) or (4, 4) array, optional
            Motion of the robot since the last update, see `relmap.core.odometry.checked_odometry`;
            that of the first update, and of the first after `take_up`, is not used. It bridges
            scans that show too little, and determines the motion in directions that walls do not;
            see `odometry`.
        stamp_s : float, optional
            Time of the scan, seconds, later than that of earlier scans; kept for the trajectory.

        Returns
        -------
        (m,) int64
            Number of each wall; see `landmarks_of`.

        Raises
        ------
        RelmapError
            If the scan is invalid; the mapper is then unchanged.
        """
        if ids is not None:
            raise RelmapError("ids were given; a plane mapper associates walls itself")
        seen = self._checked(points, beams)
        with self._guard.change():
            motion = None if odometry is None else checked_odometry(odometry)
            time_s = None if stamp_s is None else self._stamps.checked(stamp_s)
            return self._take_in(seen, motion, time_s)

    def _take_in(
        self, seen: PlaneObservation, motion: Floats | None, stamp_s: float | None
    ) -> Ints:
        if self._journal is not None:
            self._journal.ready()
        self._refined_walls = None
        self._moved = np.empty(0, dtype=np.int64)
        if self.n_iterations in self.begun:  # the motion from the last scan of another log
            motion = None
        walls = self.engine.update(seen, None, odometry=motion)
        self._stamps.append(stamp_s, self.engine.store.n_iterations - 1)
        if self._journal is not None:
            values, beams = journaled(seen), seen.beams.to_bytes()
            self._journal.append(
                RecordedScan(values, None, walls, blob=beams, odometry=motion, stamp_s=stamp_s)
            )
        return walls

    def _finish(self) -> None:
        self._onto = False
        if self._n_finished == self.n_iterations:  # links cut since would be tied again
            return
        self._n_finished, self._weak = self.n_iterations, None
        self._tie()
        super()._finish()
        self._planes.links.cut(unsupported_links(self.history, self._planes.links))
        for span in self.history.spans:
            afterwards.found_late(self.engine, *span)

    def refine(self) -> None:
        """Move walls, corners and poses to the joint least-squares solution over all observations.

        Walls that then coincide are joined, which closes loops. Where a submap deviates from a link
        by more than 0.3 m or 8 degrees, one of the two is wrong, and the submap is cut there. It is
        also cut between visits of a place that contradict each other.
        """
        with self._guard.change(), one_thread():
            self._note_call("refine")
            self._refine_and_cut()
        for submap in self.submaps:
            if submap.assembled is not None and not submap.refined:
                _LOG.warning(
                    "scans %d:%d: refinement tears the submap; it is kept as chained", *submap.span
                )

    def _refine_and_cut(self) -> None:
        self._refine_until_whole([])
        before = self._planes.links.before_join()
        joined = self._join_submaps()
        if joined and len(torn := self._torn(joined)):  # in one of the parts: join these anew
            vars(self._planes.links).update(before)
            self._planes.links.cut(torn)
            self._refine_until_whole([])
            joined = self._join_submaps()
            self._refine_until_whole(joined)
        for _ in range(CUTS):
            if not len(torn := self._contradicted()):
                break
            self._planes.links.cut(torn)
            self._refine_until_whole(joined)

    def _contradicted(self) -> Ints:
        """Return the scans (t,) before which to cut submaps that contradict themselves."""
        scans = self._planes.links.scans
        found = [contradicted_revisits(s.poses, s.first_iteration, scans) for s in self.submaps]
        return np.concatenate([np.empty(0, dtype=np.int64), *found])

    def _join_submaps(self) -> list[Floats]:
        """Join the submaps that show the same place; return the poses (i, 4, 4) of each result."""
        submaps, parts = self.submaps, list[MapPart]()
        for k in range(len(submaps)):
            table, path = self.planes_of(k), submaps[k].path
            static = table.status == "static"
            ends = table.ends[static]
            length_m = np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum()
            beams = self.beams_of(k, max(int(BEAMS_PER_M * length_m), 1))
            parts.append(MapPart.of(k, ends, table.plane[static], beams, path))
        steps = ImpliedSteps(submaps, self.history, self._planes.links)
        tied = [part for part in tied_parts(parts, steps.refute) if len(part.members) > 1]
        poses = [steps.poses(part) for part in tied]
        if tied:
            self._planes.links.join(poses, np.concatenate([part.same for part in tied]))
        return poses

    def _refine_until_whole(self, known: list[Floats]) -> None:
        """Refine all submaps, those with known poses (i, 4, 4) from these; cut the torn ones."""
        for _ in range(CUTS):
            if not len(torn := self._torn(known)):
                return
            self._planes.links.cut_torn(torn)
        self._torn(known, keep=True)

    def _torn(self, known: list[Floats], keep: bool = False) -> Ints:
        """Refine all submaps; return the scans (t,) into which they are torn.

        Torn maps are kept only with `keep`.
        """
        links, self._moved = self._planes.links, np.empty(0, dtype=np.int64)
        found = refined_submaps(replace(self._grouped, known=known), self._moving, links)
        torn = torn_in(found.submaps, self.history)
        if keep or not len(torn):
            submaps, numbers, self._moved = planned_submaps(found, self._moving, links.beams)
            self._refined_walls = submaps, numbers
        return torn

    def _current(self, labels: ArrayLike) -> Ints:
        labels = checked_labels(labels, np.arange(self._planes.n_planes))
        return np.asarray(self._own_numbers.wall_of[self._planes.now(labels)])

    @property
    def _parts(self) -> list[Any]:
        return [self, *super()._parts]

    def _again(self, scan: RecordedScan) -> Ints:
        seen = checked_planes(of_journal(scan.values))
        seen = replace(seen, beams=GivenBeams.from_bytes(scan.blob))
        time_s = None if scan.stamp_s is None else self._stamps.checked(scan.stamp_s)
        with self._guard.change():
            return self._take_in(seen, scan.odometry, time_s)
