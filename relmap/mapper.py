"""The public face of all variants: what a mapper hands out, and what makes it last."""

from __future__ import annotations

import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relmap.core import afterwards, readout
from relmap.core.config import WITH_IDS, WITH_POINTS, MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.guard import ChangeGuard
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Submap
from relmap.core.mapper import RelativeMapper
from relmap.core.model import LandmarkModel
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.joint import Refined
from relmap.core.scan import checked_labels
from relmap.shown import Shown

if TYPE_CHECKING:
    from relmap.io.journal import Journal, JournalReader, RecordedScan


class Mapper(Shown, ABC):
    """An engine with a journal, a saved state, and tables of what it has found.

    Parameters
    ----------
    config : MapperConfig, optional
    journal : path, optional
        An SQLite file that is begun, see `relmap.io.journal.layout`.  Every scan is in it with the
        first update after a second, and after `flush`; whatever happens then, `resume` goes on.
    run : dict, optional
        What the journal should tell about the run, fit for JSON.

    Attributes
    ----------
    engine : RelativeMapper
        What maps: its landmark table, store, schedule and groups, for experiments that look at
        them.  What is changed there is neither checked nor kept in a journal.

    Raises
    ------
    RelmapError
        If the journal already exists or cannot be written.
    """

    _variant: ClassVar[str]
    _unused: ClassVar[dict[str, str]] = WITH_POINTS
    """Settings that the variant ignores, and why."""

    def __init__(
        self,
        config: MapperConfig | None = None,
        journal: PathLike[str] | str | None = None,
        run: dict[str, Any] | None = None,
    ) -> None:
        self.config = config or MapperConfig()
        self.config.refuse(self._unused)
        self._guard = ChangeGuard()
        self._engine = RelativeMapper(self._model(), self.config)
        self._journal: Journal | None = None
        if journal is not None:
            from relmap.io.journal import Journal
            from relmap.io.journal.layout import LAYOUTS

            meta = {
                "variant": self._variant,
                "configuration": asdict(self.config),
                "versions": _versions(),
                "run": run,
            }
            self._journal = Journal.create(Path(journal), LAYOUTS[self._variant], meta)

    @property
    def engine(self) -> RelativeMapper:
        """What maps, see above.

        Raises
        ------
        RelmapError
            If an update was interrupted half way, or another thread is in one.
        """
        self._guard.check()
        return self._engine

    def finish(self) -> None:
        """Group what is still in view and not mapped yet, and what has left for the last time."""
        with self._guard.change():
            self._note_call("finish")
            self._finish()

    def _finish(self) -> None:
        afterwards.finish(self.engine)

    def landmarks_of(self, labels: ArrayLike) -> NDArray[np.int64]:
        """Return what landmarks (n,), labelled by earlier updates, are called now.

        A landmark lost and seen again has a label of its own until it is recognised; -1 stays.
        A label that no update has returned raises `RelmapError`.
        """
        labels = checked_labels(labels, np.append(readout.labels(self.engine), -1))
        if self.engine.association.has_ids:
            return labels
        return np.where(labels >= 0, self.engine.table.landmark_of[labels], labels)

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that the mapper makes use of, by name."""
        is_known = self.engine.association.is_known
        return self.config.in_use(WITH_IDS if is_known else self._unused)

    @property
    def n_iterations(self) -> int:
        """How many scans were taken in, empty ones included."""
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
        """The submaps, the largest first; more than one where nothing ties parts of the run."""
        return readout.map_submaps(self.engine)

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups behind the map, in the order in which they were placed."""
        return readout.mapped_groups(self.engine)

    @property
    def refined(self) -> list[Refined]:
        """The submaps as refined, in ascending order; none after a later update.

        They tell how well each segment of the run, and each merge, fits the map.  Landmarks go by
        their numbers there, in order of first sight.
        """
        return list(self.engine.refined)

    @property
    def rejected(self) -> NDArray[np.int64]:
        """Iterations (r,), ascending, whose scans fit no other and so add nothing to the map."""
        return self.engine.association.rejected

    @property
    def tied_share(self) -> float | None:
        """Share of the scans that were tied to those before at once, of points without ids.

        The others began tracks, and perhaps submaps, of their own.  Rivals are looked for only
        where nearest neighbours do not agree at once, so it does not tell that ties are right.
        None if nothing was matched
        so: with ids, of walls, by another registration.
        """
        return self.engine.association.tied_share

    @property
    def unique_share(self) -> float | None:
        """Share of the scans whose matches are more than chance brings in any placement.

        Of points without ids, else None.  It does not reveal places that look alike.
        """
        return self.engine.association.unique_share

    @property
    def n_undone(self) -> int:
        """How many merges were undone because the refined map contradicted them."""
        return self.engine.merger.n_undone

    @property
    def odometry(self) -> OdometryUse | None:
        """What was made of odometry at the last `finish` or `refine`; None where none came."""
        return self.engine.odometry

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """``T_map_robot`` of every iteration (k, 4, 4), for display; NaN where it is not fixed."""
        return readout.path(self.engine)

    @property
    def noise_m(self) -> float:
        """Estimated standard deviation of an observed coordinate, metres; NaN if not known yet."""
        return float(self.engine.averaging.noise.sigma_m)

    @classmethod
    def resume(
        cls, journal: PathLike[str] | str, after: Callable[[Self], object] | None = None
    ) -> Self:
        """Return the mapper that kept a journal, as it was after the last scan in it.

        It is made by mapping the scans of the journal again, which gives the same to the last bit,
        and goes on to keep the journal.

        Parameters
        ----------
        journal : path
        after : callable, optional
            Is given the mapper after each scan, to look at it.

        Raises
        ------
        RelmapError
            If there is no journal, it is of another variant or a newer relmap, or damaged, or
            where mapping the scans again gives something else than was noted.
        """
        from relmap.io.journal import Journal, JournalReader

        with JournalReader(Path(journal)) as reader:
            if reader.layout.variant != cls._variant:
                raise RelmapError(
                    f"journal {reader.path} is of {reader.layout.variant}, and {cls.__name__} maps "
                    f"{cls._variant}"
                )
            mapper = cls(MapperConfig.from_mapping(reader.meta["configuration"]))
            for _ in mapper._replayed(reader):
                if after is not None:
                    after(mapper)
        mapper._journal = Journal.go_on(reader)
        return mapper

    def save(self, path: PathLike[str] | str) -> None:
        """Save the whole state: a mapper loaded from it goes on as this one would, to the last bit.

        The journal is not part of it, nor is a segmenter.

        Parameters
        ----------
        path : path
            A file, ``.npz`` by custom; one of that name is replaced.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        from relmap.io.saving import save_state

        kind, settings = type(self).__name__, asdict(self.config)
        about = {"mapper": kind, "configuration": settings, "versions": _versions()}
        save_state(Path(path), self._parts, about)

    @classmethod
    def load(cls, path: PathLike[str] | str) -> Self:
        """Load a mapper that `save` saved.

        What the file says is not run, but its numbers are believed: load what you trust.

        Parameters
        ----------
        path : path

        Raises
        ------
        RelmapError
            If there is no such file, it is damaged, or holds a mapper of another variant or of
            a relmap with other parts.
        """
        from relmap.io.saving import load_state

        made: list[Self] = []

        def begin(header: dict[str, Any]) -> list[Any]:
            if header["mapper"] != cls.__name__:
                kind = f"{header['mapper']!s:.20}"
                raise RelmapError(f"{path} holds a {kind}, not a {cls.__name__}")
            made.append(cls(MapperConfig.from_mapping(header["configuration"])))
            return made[0]._parts

        load_state(Path(path), begin)
        return made[0]

    def flush(self) -> None:
        """Make sure that the journal holds every scan; where none is kept, do nothing.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        if self._journal is not None:
            with self._guard.change():
                self._journal.flush()

    def close(self) -> None:
        """Flush and end the journal; where none is kept, do nothing.

        Raises
        ------
        RelmapError
            If it cannot be written.
        """
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the journal: a copy keeps none."""
        return self.__dict__ | {"_journal": None}

    def _note_call(self, name: str) -> None:
        if self._journal is not None:
            self._journal.call(name)

    def _replayed(self, reader: JournalReader) -> Iterator[None]:
        """Take in the scans of a journal, one at a time."""
        for k, scan in enumerate(reader.scans()):
            for call in reader.calls.get(k, []):
                getattr(self, call)()
            if not np.array_equal(self._again(scan), scan.labels):
                raise RelmapError(
                    f"journal {reader.path}: iteration {k} mapped again gives other landmarks than "
                    f"were noted; it was written by {_told(reader.meta.get('versions'))}, "
                    f"and this is {_told(_versions())}"
                )
            yield

    @property
    def _parts(self) -> list[Any]:
        """What has state, see `relmap.core.state.saved`."""
        return [self.engine]

    @abstractmethod
    def _model(self) -> LandmarkModel:
        """Return the kind of landmark that is mapped."""

    @abstractmethod
    def _again(self, scan: RecordedScan) -> NDArray[np.int64]:
        """Take in a scan of the journal."""


def _versions() -> dict[str, str]:
    import scipy

    import relmap

    return {
        "relmap": relmap.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "machine": platform.machine(),
    }


def _told(versions: Any) -> str:
    if not isinstance(versions, dict):
        return "unknown versions"
    return ", ".join(f"{name} {version}" for name, version in versions.items())
