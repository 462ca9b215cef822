"""The public interface of the mappers of points and walls."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import asdict
from os import PathLike
from typing import Any, NamedTuple, Self

from relmap.core import afterwards
from relmap.core.arrays import Floats
from relmap.core.config import MapperConfig, changed, refuse
from relmap.core.guard import reads_whole
from relmap.core.linalg.threads import one_thread
from relmap.core.mapper import RelativeMapper
from relmap.core.model import LandmarkModel
from relmap.mapped import Mapped
from relmap.recorded import Recorded


class Place(NamedTuple):
    """The place of a scan in a map.

    Attributes
    ----------
    T_map_robot : (4, 4) float64
        NaN unless the scan fits in exactly one place.
    n_places : int
        Number of places in which it fits: 0, 1, or 2 for several.
    """

    T_map_robot: Floats
    n_places: int


@reads_whole("finish")
class Mapper(Recorded, Mapped):
    """An engine with a journal, a saved state and tables of its results.

    Parameters
    ----------
    config : MapperConfig, optional
    journal, run
        See `Recorded`.

    Raises
    ------
    RelmapError
        If the journal already exists or cannot be written.
    """

    def __init__(
        self,
        config: MapperConfig | None = None,
        journal: PathLike[str] | str | None = None,
        run: dict[str, Any] | None = None,
    ) -> None:
        self.config = config or MapperConfig()
        refuse(changed(self.config), self._unused)
        self._engine = RelativeMapper(self._model(), self.config)
        super().__init__(journal, run)

    def finish(self) -> None:
        """Group unmapped landmarks in view, and run the last pass of those that left.

        Where walls repeat, all scans may be mapped again, and walls and corners numbered anew.
        """
        with self._guard.change(), one_thread():
            self._note_call("finish")
            self._finish()

    def _finish(self) -> None:
        afterwards.finish(self.engine)

    @property
    def _configuration(self) -> dict[str, Any]:
        return asdict(self.config)

    @classmethod
    def _configured(cls, configuration: Any) -> Self:
        return cls(MapperConfig.from_mapping(configuration))

    @property
    def _parts(self) -> list[Any]:
        return [self._stamps, self.engine]

    @abstractmethod
    def _model(self) -> LandmarkModel:
        """Return the kind of landmark that is mapped."""
