"""The results of a mapper: the map, the table of all landmarks, and the groups behind it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.shown import Brief, Table


def in_space(positions: Floats) -> Floats:
    """Return positions (n, d) as (n, 3), with z = 0 in a planar world."""
    spatial = np.zeros((len(positions), 3))
    spatial[:, : positions.shape[1]] = positions
    spatial[np.isnan(positions).any(axis=1)] = np.nan
    return spatial


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkMap(Table):
    """The mapped landmarks: those of the first submap.

    Attributes
    ----------
    landmark_ids : (m,) int64
        The given id, or the track number if there are no ids.
    positions : (m, 3) float64, map frame, metres
        z is 0 in a planar world.
    covariances : (m, 3, 3) float64, map frame, square metres
        Covariances of the position errors, after refinement. The map frame is the true robot frame
        in the first iteration that the landmarks determine. The uncertainty of that iteration's
        pose is included and grows with the distance from it. Before refinement: those of the
        averages only. (0, 3, 3) if unknown.
    """

    landmark_ids: Ints
    positions: Floats
    covariances: Floats = field(default_factory=lambda: np.empty((0, 3, 3)))


@dataclass(frozen=True, eq=False, repr=False)
class Submap(Brief):
    """A part of the map with its own frame, not connected to the rest.

    Attributes
    ----------
    landmark_ids : (m,) int64
    positions : (m, 3) float64, frame of the submap, metres
    first_iteration, last_iteration : int
        First and last iteration that saw its landmarks, counted from the mapper's first update.
    """

    landmark_ids: Ints
    positions: Floats
    first_iteration: int
    last_iteration: int


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkTable(Table):
    """Every landmark ever seen, one row each, in ascending order of labels.

    Attributes
    ----------
    landmark : (n,) int64
        The given id, or the track number if there are no ids.
    position : (n, 3) float64, map frame, metres
        NaN for unmapped landmarks.
    sd : (n,) float64, metres
        Standard deviation of the position, root mean square over the axes, in the map frame; see
        `LandmarkMap.covariances`. Before refinement: that of the average behind the position,
        without the drift along the chain of groups. NaN for unmapped landmarks.
    observations : (n,) int64
    first_iteration, last_iteration : (n,) int64
        Counted from the mapper's first update.
    level : (n,) int64
        Grouping level of the position; 0 for unmapped landmarks.
    status : (n,) str
        "static", "dynamic" or "unmapped".
    submap : (n,) int64
        Index of the landmark's submap in descending order of size: 0 for the map itself, positive
        for submaps not connected to it (whose landmarks count as unmapped here), -1 for none.
    moving_bin : (n,) int64
        For dynamic landmarks that keep their mutual distances, such as parts of a vehicle, the
        label of one of them, the same for all; -1 otherwise.
    """

    landmark: Ints
    position: Floats
    sd: Floats
    observations: Ints
    first_iteration: Ints
    last_iteration: Ints
    level: Ints
    status: NDArray[np.str_]
    submap: Ints
    moving_bin: Ints

    @property
    def landmark_ids(self) -> Ints:
        """Same as `landmark`, under the name used by `LandmarkMap`."""
        return self.landmark

    @property
    def positions(self) -> Floats:
        """Same as `position`, under the name used by `LandmarkMap`."""
        return self.position


@dataclass(frozen=True, eq=False, repr=False)
class MappedGroup(Brief):
    """A group and its relative map (Figs 8 and 11), completed by all static landmarks of its chart.

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

    landmarks: Ints
    relative_map: Floats
    n_observations: Ints
    iterations: Ints
