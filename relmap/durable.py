"""What makes a mapper last beyond its process: a journal of its scans, and a file of its state."""

from __future__ import annotations

import platform
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from relmap.core.config import WITH_IDS, MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.mapper import RelativeMapper
from relmap.core.registration import KnownAssociation

if TYPE_CHECKING:
    from relmap.journal import Journal, JournalReader, RecordedScan


class DurableMapper(RelativeMapper):
    """A mapper that can keep a journal.

    Parameters
    ----------
    config : MapperConfig, optional
    journal : path, optional
        An SQLite file that is begun, see `relmap.journal.layout`.  Every scan is in it with the
        first update after a second, and after `flush`; whatever happens then, `resume` goes on.
    run : dict, optional
        What the journal should tell about the run, fit for JSON.

    Raises
    ------
    RelmapError
        Where the journal is there already or cannot be written.
    """

    _variant: ClassVar[str]
    _passing: ClassVar[tuple[str, ...]] = ("_journal",)
    """What is not saved."""

    def __init__(
        self,
        config: MapperConfig | None = None,
        journal: PathLike[str] | str | None = None,
        run: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(config)
        self._journal: Journal | None = None
        if journal is not None:
            from relmap.journal import Journal
            from relmap.journal.layout import LAYOUTS

            meta = {
                "variant": self._variant,
                "configuration": asdict(self.config),
                "versions": _versions(),
                "run": run,
            }
            self._journal = Journal.create(Path(journal), LAYOUTS[self._variant], meta)

    @classmethod
    def resume(cls, journal: PathLike[str] | str) -> Self:
        """Return the mapper that kept a journal, as it was after the last scan in it.

        It is made by mapping the scans of the journal again, which gives the same to the last bit,
        and goes on to keep the journal.

        Parameters
        ----------
        journal : path

        Raises
        ------
        RelmapError
            Where there is no journal, it is of another variant or a newer relmap, or damaged, or
            where mapping the scans again gives something else than was noted.
        """
        from relmap.journal import Journal, JournalReader

        with JournalReader(Path(journal)) as reader:
            if reader.layout.variant != cls._variant:
                raise RelmapError(
                    f"journal {reader.path} is of {reader.layout.variant}, and {cls.__name__} maps "
                    f"{cls._variant}"
                )
            mapper = cls(MapperConfig.from_mapping(reader.meta["configuration"]))
            mapper._replay(reader)
            layout = reader.layout
        mapper._journal = Journal(Path(journal), layout, mapper.n_iterations)
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
            Where it cannot be written.
        """
        from relmap.saving import save_state

        about = {"variant": self._variant, "versions": _versions()}
        save_state(Path(path), self, about, self._passing)

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
            Where there is no such file, it is damaged, or holds a mapper of another variant or of
            a relmap with other parts.
        """
        from relmap.saving import load_state

        mapper: Self = load_state(Path(path), cls)
        return mapper

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that the mapper makes use of, by name."""
        is_known = isinstance(self._registration, KnownAssociation)
        return self.config.in_use(WITH_IDS if is_known else self._unused)

    @property
    def n_iterations(self) -> int:
        """How many scans were taken in, empty ones included."""
        return self._store.n_iterations

    def flush(self) -> None:
        """Make sure that the journal holds every scan; where none is kept, do nothing.

        Raises
        ------
        RelmapError
            Where it cannot be written.
        """
        if self._journal is not None:
            self._journal.flush()

    def close(self) -> None:
        """Flush and end the journal; where none is kept, do nothing.

        Raises
        ------
        RelmapError
            Where it cannot be written.
        """
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def finish(self) -> None:
        """Group what is still in view and not mapped yet, and what has left for the last time."""
        self._note_call("finish")
        super().finish()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the journal: a copy keeps none."""
        return self.__dict__ | {"_journal": None}

    def _note_call(self, name: str) -> None:
        if self._journal is not None:
            self._journal.call(name)

    def _replay(self, reader: JournalReader) -> None:
        for k, scan in enumerate(reader.scans()):
            for call in reader.calls.get(k, []):
                getattr(self, call)()
            if not np.array_equal(self._again(scan), scan.labels):
                raise RelmapError(
                    f"journal {reader.path}: iteration {k} mapped again gives other landmarks than "
                    f"were noted; it was written by {_told(reader.meta.get('versions'))}, "
                    f"and this is {_told(_versions())}"
                )

    def _again(self, scan: RecordedScan) -> NDArray[np.int64]:
        """Take in a scan of the journal."""
        raise NotImplementedError


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
