"""How a mapper is shown and saved: as text, as a picture, as a result folder."""

from __future__ import annotations

from html import escape
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relmap.core.guard import reads_whole

if TYPE_CHECKING:
    from relmap.core.landmarks import LandmarkMap

# Plots and results are layers above the mappers and are imported by name only when used.
RESULTS, PICTURES = "relmap.evaluation.saved", "relmap.plots.of_mapper"


@reads_whole()
class Shown:
    """A mapper that can be displayed."""

    @property
    def n_iterations(self) -> int:
        """Number of scans processed."""
        raise NotImplementedError

    @property
    def map(self) -> LandmarkMap:
        """The mapped landmarks."""
        raise NotImplementedError

    def plot(self) -> Any:
        """Draw the current map: landmarks of points, or the floor plan of walls by submap.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return import_module(PICTURES).plot_mapper(self)

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
        import_module(RESULTS).save_results(self, Path(folder), import_module(PICTURES))

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
