"""Localising scans in the map of a plane mapper, and adding another log to it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.guard import reads_whole
from relmap.mapper import Place
from relmap.planes.mapped import MappedWalls
from relmap.planes.places.finding import place_among
from relmap.planes.scans.observation import PlaneObservation, checked_planes
from relmap.planes.submaps.grouped_map import KeptFrame


@reads_whole("take_up")
class LocatingMapper(MappedWalls):
    """The part of `PlaneMapper` that localises scans."""

    _segmenter: Any
    _walls: tuple[object, Floats] | None = None
    _onto: bool = False

    @property
    def tied_at(self) -> int | None:
        """The first iteration of the last log that is in the submap of the map it was added to.

        None if none is. `refine` connects them, see `take_up`.
        """
        if self._frame is None:
            return None
        submaps, begun_at = self._planes.links.submaps, self._frame.begun_at
        own = np.flatnonzero(submaps[begun_at:] == submaps[self._frame.scan])
        return begun_at + int(own[0]) if len(own) else None

    def locate(self, points: Any, beams: ArrayLike | None = None) -> Place:
        """Localise a scan using only the map; the mapper does not change.

        Parameters
        ----------
        points, beams
            As for `update`; planes without beams are not localised.

        Returns
        -------
        Place
            The pose ``T_map_robot`` (4, 4), and the number of places in which the scan fits. The
            pose is NaN unless that is one: at least half of its walls, and 3 m, must lie on mapped
            walls that are not all parallel, 70 % of its beams must end there (or 30 % and half of
            the beams, if at most 2 % go through walls; 90 % for fewer than five walls), and no
            other place may score nearly as well.

        Raises
        ------
        RelmapError
            If the scan is invalid.
        """
        seen, latest = self._checked(points, beams), self._guard.latest
        known = self._walls
        if known is None or known[0] is not latest:
            table = self.planes
            known = self._walls = latest, table.ends[table.status == "static"]
        return place_among(seen, known[1])

    def localise(self, points: Any, beams: ArrayLike | None = None) -> Floats:
        """Localise a scan using only the map; the mapper does not change.

        Parameters
        ----------
        points, beams
            As for `locate`.

        Returns
        -------
        (4, 4) float64
            ``T_map_robot``; NaN if the scan is not found, or is ambiguous.

        Raises
        ------
        RelmapError
            If the scan is invalid.
        """
        return self.locate(points, beams).T_map_robot

    def take_up(self, points: Any, beams: ArrayLike | None = None) -> bool:
        """Begin another log with the next scan, which may be taken anywhere in the map.

        The log has separate submaps until `refine`, which joins those that show the same place as
        the map. The map keeps its frame, and stays the first of the `submaps`; see `tied_at`.
        Further calls change nothing until `finish`.

        Parameters
        ----------
        points, beams
            The scan of the next `update`, as for that.

        Returns
        -------
        bool
            Whether this scan alone would be localised, see `locate`.

        Raises
        ------
        RelmapError
            If the scan is invalid, or a journal is kept, which cannot record this.
        """
        if self._journal is not None:
            raise RelmapError("a run that keeps a journal begins with an empty map")
        is_found = self.locate(points, beams).n_places == 1
        if not self._onto:
            frame = KeptFrame.of(self.submaps, self.n_iterations)
            with self._guard.change():
                self._planes.begin_run()
                self._onto, self._frame = True, frame
        return is_found

    def _segmented(self, points: Any) -> Any:
        if self._segmenter is None:
            from relmap.segmentation import PlaneSegmenter

            self._segmenter = PlaneSegmenter()
        # The segmenter stores its result: two threads would mix theirs.
        with self._guard.change(spoils=False):
            self._segmenter.fit(points)
            return self._segmenter.planes_

    def _checked(self, points: Any, beams: Any) -> PlaneObservation:
        """Return the walls of a scan given by walls or points."""
        if not hasattr(points, "ends"):
            beams = points if beams is None else beams
            points = self._segmented(points)
        return checked_planes(points, beams)
