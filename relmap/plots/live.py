"""Live view of a run in the Rerun viewer, or recorded in a file for it (`relmap[live]`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.evaluation.feeding import AnyMapper
from relmap.planes import PlaneMapper
from relmap.planes3d import Plane3dMapper
from relmap.plots.path import split_at_jumps

SHARE = 0.1
"""Approximate fraction of the time spent on the view."""
MAP, PATH, SCAN = "map", "path", "scan"
"""Names of the entities in the viewer."""
COLOURS = {MAP: (51, 51, 51), PATH: (138, 138, 138), SCAN: (217, 130, 43)}
RADIUS_M = 0.03
INSTALL = "--live needs the Rerun viewer: pip install 'relmap[live]'"


class LiveView:
    """Shows map, path and scan of a run, after every scan if that takes little of the time.

    Rerun's analytics are off.

    `file`: file to record in; None opens the viewer. `clock`: returns the time, seconds. Raises
    `RelmapError` if Rerun is not installed, the viewer does not start or the file cannot be
    written.
    """

    def __init__(self, file: Path | None = None, clock: Callable[[], float] = perf_counter) -> None:
        if find_spec("rerun") is None:
            raise RelmapError(INSTALL)
        import rerun

        self._rerun, self._clock = rerun, clock
        self._stream = rerun.RecordingStream("relmap")
        self._due = -np.inf
        self._scan: Any = None
        try:
            # Without usage data of processes started here: Rerun sends none if CI is set.
            with patch.dict(os.environ, CI=os.environ.get("CI") or "true"):
                if file is None:
                    self._stream.spawn(hide_welcome_screen=True)
                else:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    self._stream.save(file)
        except (OSError, RuntimeError) as error:
            what = "the Rerun viewer does not start" if file is None else f"{file}: not writable"
            raise RelmapError(f"{what}: {' '.join(str(error).split())}") from error

    def watch(self, mapper: AnyMapper, scans: Iterable[Any]) -> Iterator[Any]:
        """Yield the scans of a run; show them once they are mapped."""
        for scan in scans:
            yield scan
            self._scan = scan
            began = self._clock()
            if began >= self._due:
                self.show(mapper)
                now = self._clock()
                self._due = now + (now - began) * (1 / SHARE - 1)

    def show(self, mapper: AnyMapper) -> None:
        """Show the current map and path, and the last scan if it has a pose."""
        d = 3
        if self._scan is not None:
            self._stream.set_time("iteration", sequence=self._scan.iteration)
        if isinstance(mapper, Plane3dMapper):
            cells = [part.all_planes().cells for part in mapper.submaps[:1]]
            self._points(MAP, np.concatenate([np.empty((0, 3)), *cells]))
        elif isinstance(mapper, PlaneMapper):
            table, d = mapper.planes, 2
            self._lines(MAP, list(table.ends[table.status == "static"]), d)
        else:
            d = mapper.engine.store.dimension or 2
            self._points(MAP, mapper.map.positions[:, :d])
        poses = mapper.trajectory
        self._lines(PATH, split_at_jumps(poses[np.isfinite(poses[:, 0, 3]), :d, 3]), d)
        if self._scan is not None and len(poses) and np.isfinite(poses[-1, 0, 3]):
            R, t = poses[-1, :d, :d], poses[-1, :d, 3]
            self._points(SCAN, self._scan.points_robot[:, :d] @ R.T + t)

    def close(self) -> None:
        """Flush and end the recording."""
        self._stream.flush()
        self._stream.disconnect()

    def _points(self, name: str, places: Floats) -> None:
        kind = self._rerun.Points2D if places.shape[1] == 2 else self._rerun.Points3D
        shown = kind(places.astype(np.float32), colors=COLOURS[name], radii=RADIUS_M)
        self._stream.log(name, shown)

    def _lines(self, name: str, ways: list[Floats], d: int) -> None:
        kind = self._rerun.LineStrips2D if d == 2 else self._rerun.LineStrips3D
        shown = [way.astype(np.float32) for way in ways if len(way)]
        self._stream.log(
            name, kind(shown or np.empty((0, 2, d)), colors=COLOURS[name], radii=RADIUS_M)
        )
