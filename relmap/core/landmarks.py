"""What a mapper hands out: the map, the table of all landmarks, and the groups behind it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from relmap.core.columns import Table


def in_space(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions (n, d) as (n, 3), with z = 0 where the world is planar."""
    spatial = np.zeros((len(positions), 3))
    spatial[:, : positions.shape[1]] = positions
    spatial[np.isnan(positions).any(axis=1)] = np.nan
    return spatial


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkMap(Table):
    """The mapped landmarks: those of the largest submap.

    Attributes
    ----------
    landmark_ids : (m,) int64
        The given id, or the number of the track where none was given.
    positions : (m, 3) float64, map frame, metres
        z is 0 in a planar world.
    covariances : (m, 3, 3) float64, map frame, square metres
        Of the errors of the positions, after refinement.  The map frame is that of the robot in
        the first iteration that its landmarks fix, as it was: that this iteration is known no
        better than by what was seen in it is part of the errors, the more the farther away.
        Before refinement those of the averages alone.  (0, 3, 3) where nothing is known.
    """

    landmark_ids: NDArray[np.int64]
    positions: NDArray[np.float64]
    covariances: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3, 3)))


@dataclass(frozen=True, eq=False)
class Submap:
    """A part of the map with a frame of its own, which nothing ties to the rest.

    Attributes
    ----------
    landmark_ids : (m,) int64
    positions : (m, 3) float64, frame of the submap, metres
    first_iteration, last_iteration : int
        When its landmarks were seen first and last, counted from the mapper's first update.
    """

    landmark_ids: NDArray[np.int64]
    positions: NDArray[np.float64]
    first_iteration: int
    last_iteration: int


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkTable(Table):
    """Every landmark ever seen, one row each, in ascending order of its label.

    Attributes
    ----------
    landmark : (n,) int64
        The given id, or the number of the track where none was given.
    position : (n, 3) float64, map frame, metres
        NaN where the landmark is not mapped.
    sd : (n,) float64, metres
        One standard deviation of the position, root mean over the axes, in the frame of the map;
        see `LandmarkMap.covariances`.  Before refinement that of the average behind the position:
        what the chain of groups adds on the way is not in it.  NaN where it is not mapped.
    observations : (n,) int64
    first_iteration, last_iteration : (n,) int64
        Counted from the mapper's first update.
    level : (n,) int64
        Grouping level of the position; 0 where the landmark is not mapped.
    status : (n,) str
        "static", "dynamic" or "unmapped".
    submap : (n,) int64
        Place of the landmark's submap in the order of their sizes: 0 for the map itself, above 0
        for submaps that nothing ties to it (those landmarks count as not mapped here), -1 for none.
    moving_bin : (n,) int64
        Of a dynamic landmark that keeps its distances from others, as the parts of a vehicle do,
        the label of one of them, the same for all; -1 for every other landmark.
    """

    landmark: NDArray[np.int64]
    position: NDArray[np.float64]
    sd: NDArray[np.float64]
    observations: NDArray[np.int64]
    first_iteration: NDArray[np.int64]
    last_iteration: NDArray[np.int64]
    level: NDArray[np.int64]
    status: NDArray[np.str_]
    submap: NDArray[np.int64]
    moving_bin: NDArray[np.int64]

    @property
    def landmark_ids(self) -> NDArray[np.int64]:
        """The same as `landmark`, by the name that it has in a `LandmarkMap`."""
        return self.landmark

    @property
    def positions(self) -> NDArray[np.float64]:
        """The same as `position`, by the name that it has in a `LandmarkMap`."""
        return self.position


@dataclass(frozen=True, eq=False)
class MappedGroup:
    """A group and its relative map (Figs 8 and 11), completed to all that its chart saw at rest.

    Attributes
    ----------
    landmarks : (n,) int64
        Labels.
    relative_map : (n, d) float64, group frame, metres
    n_observations : (n,) int64
        Observations behind each position.
    iterations : (i,) int64, ascending
        The common interval.
    """

    landmarks: NDArray[np.int64]
    relative_map: NDArray[np.float64]
    n_observations: NDArray[np.int64]
    iterations: NDArray[np.int64]
