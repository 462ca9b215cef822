"""A mapper with a journal, a saved state, a picture and a result folder, whatever it maps."""

from __future__ import annotations

import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.core.guard import ChangeGuard, reads_whole
from relmap.core.stamps import Stamps
from relmap.io.journal import Journal, JournalReader, RecordedScan
from relmap.io.journal.layout import LAYOUTS

M = TypeVar("M", bound="Recorded")
# Plots and results are layers above the mappers and are imported by name only when used.
RESULTS = "relmap.plots.of_mapper"

_MAPS = {
    "PointMapper": "a map of points",
    "PlaneMapper": "a map of walls",
    "Plane3dMapper": "a map of planes in space",
    "Mapper": "a map of points or walls",
}


@reads_whole("flush", "close")
class Recorded(ABC):
    """Records the scans of a mapper in a journal, and saves its state.

    Parameters
    ----------
    journal : path, optional
        A new SQLite file, see `relmap.io.journal.layout`. Scans are committed about once a second
        and by `flush`; `resume` continues from it after a crash.
    run : dict, optional
        Description of the run to store in the journal; must be JSON serialisable.

    Raises
    ------
    RelmapError
        If the journal already exists or cannot be written.
    """

    _variant: ClassVar[str]

    def __init__(
        self, journal: PathLike[str] | str | None = None, run: dict[str, Any] | None = None
    ) -> None:
        self._guard = ChangeGuard()
        self._stamps = Stamps()
        self._journal: Journal | None = None
        if journal is not None:
            meta = {
                "variant": self._variant,
                "configuration": self._configuration,
                "versions": _versions(),
                "run": run,
            }
            self._journal = Journal.create(Path(journal), LAYOUTS[self._variant], meta)

    @classmethod
    def resume(
        cls, journal: PathLike[str] | str, after: Callable[[Self], object] | None = None
    ) -> Self:
        """Restore a mapper from its journal, in the state after the last recorded scan.

        The scans of the journal are mapped again, which gives bit-identical results. The mapper
        then continues to write the journal.

        Parameters
        ----------
        journal : path
        after : callable, optional
            Called with the mapper after each scan.

        Raises
        ------
        RelmapError
            If there is no journal, it belongs to another variant or a newer relmap, is damaged, or
            mapping the scans again gives other results than those recorded.
        """
        with JournalReader(Path(journal)) as reader:
            if reader.layout.variant != cls._variant:
                raise RelmapError(
                    f"journal {reader.path} is of {reader.layout.variant}, and {cls.__name__} maps "
                    f"{cls._variant}"
                )
            try:
                mapper = cls._configured(reader.meta["configuration"])
            except RelmapError as error:
                raise RelmapError(f"journal {reader.path}: its configuration: {error}") from error
            for _ in mapper._replayed(reader):
                if after is not None:
                    after(mapper)
        mapper._journal = Journal.go_on(reader)
        return mapper

    def save(self, path: PathLike[str] | str) -> None:
        """Save the whole state; a mapper loaded from it continues with bit-identical results.

        Neither the journal nor a segmenter is saved.

        Parameters
        ----------
        path : path
            The file, usually ``.npz``; an existing file is replaced.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        from relmap.io.saving import save_state

        kind, settings = type(self).__name__, self._configuration
        about = {"mapper": kind, "configuration": settings, "versions": _versions()}
        save_state(Path(path), self._parts, about)

    @classmethod
    def load(cls, path: PathLike[str] | str) -> Self:
        """Load a mapper that `save` wrote; `Mapper.load` accepts points and walls.

        No code in the file is executed, but its values are not verified: load only trusted files.

        Parameters
        ----------
        path : path

        Raises
        ------
        RelmapError
            If there is no such file, it is damaged, or it was saved by another variant or an
            incompatible version.
        """
        from relmap.io.saving import load_state

        made: list[Self] = []

        def begin(header: dict[str, Any]) -> list[Any]:
            name = header["mapper"]
            kind = next((kind for kind in _kinds(cls) if kind.__name__ == name), None)
            if kind is None:
                found, wanted = (_MAPS.get(of, f"a {of}") for of in (f"{name!s:.20}", cls.__name__))
                raise RelmapError(f"{path} holds {found}, not {wanted}")
            made.append(kind._configured(header["configuration"]))
            return made[0]._parts

        load_state(Path(path), begin)
        return made[0]

    def flush(self) -> None:
        """Commit all scans to the journal; do nothing if there is none.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        if self._journal is not None:
            with self._guard.change():
                self._journal.flush()

    def close(self) -> None:
        """Flush and close the journal; do nothing if there is none.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def plot(self) -> Any:
        """Draw the current map: landmarks of points, the floor plan of walls by submap, or planes.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return import_module(RESULTS).plot_mapper(self)

    def save_results(self, folder: PathLike[str] | str) -> None:
        """Write the files that `relmap map` writes of a map, except the tracks, into a folder.

        The trajectory has the times given to `update` if every scan had one, else the numbers of
        the iterations. ``tracks.csv.gz`` is empty: the log is not known here.

        Parameters
        ----------
        folder : path
            Created if missing.

        Raises
        ------
        RelmapError
            If the folder cannot be written; an earlier result in it is then left unchanged.
        """
        import_module(RESULTS).save_results(self, Path(folder))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the journal: a copy has none."""
        return self.__dict__ | {"_journal": None}

    def _note_call(self, name: str) -> None:
        if self._journal is not None:
            self._journal.call(name)

    def _replayed(self, reader: JournalReader) -> Iterator[None]:
        """Map the scans of a journal, one at a time."""
        for k, scan in enumerate(reader.scans()):
            for call in reader.calls.get(k, []):
                getattr(self, call)()
            if not np.array_equal(self._again(scan), scan.labels):
                raise RelmapError(
                    f"journal {reader.path}: iteration {k} mapped again gives landmarks other than "
                    f"were recorded; it was written by {_listed(reader.meta.get('versions'))}, "
                    f"and this is {_listed(_versions())}"
                )
            yield

    @property
    @abstractmethod
    def _configuration(self) -> dict[str, Any]:
        """The settings as stored, JSON serialisable."""

    @classmethod
    @abstractmethod
    def _configured(cls, configuration: Any) -> Self:
        """Return a new mapper with stored settings; RelmapError if they are invalid."""

    @property
    @abstractmethod
    def _parts(self) -> list[Any]:
        """The parts with state, see `relmap.io.state`."""

    @abstractmethod
    def _again(self, scan: RecordedScan) -> Ints:
        """Map one scan of the journal."""


def _kinds(mapper: type[M]) -> list[type[M]]:
    """Return a class of mappers and all that are derived from it."""
    return [mapper, *(kind for each in mapper.__subclasses__() for kind in _kinds(each))]


def versions() -> dict[str, str]:
    """Return the versions of the software that results may depend on."""
    import scipy

    import relmap

    return {
        "relmap": relmap.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def _versions() -> dict[str, str]:
    return versions() | {"machine": platform.machine()}


def _listed(versions: Any) -> str:
    if not isinstance(versions, dict):
        return "unknown versions"
    return ", ".join(f"{name} {version}" for name, version in versions.items())
