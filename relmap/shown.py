"""How a mapper is shown and saved: as text, as a picture, as a result folder."""

from __future__ import annotations

from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

from relmap.core.guard import reads_whole

# Plots and results are layers above the mappers and are imported by name only when used.
RESULTS = "relmap.plots.of_mapper"


@reads_whole()
class Shown:
    """A mapper that can be displayed."""

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
