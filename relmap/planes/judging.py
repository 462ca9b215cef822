"""What walls and beams say of motions: log odds that each is right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relmap.planes.beams import Beams
from relmap.planes.placement import Match

AGREES = 0.25
"""Least share of the points that must agree."""
MATCHED, MATCHES, AGREEING, CONTRADICTING, NONE = 6.8, 4.2, 4.0, -57.0, -2.0
"""Log odds of a motion by the share of the walls that match, by how many do, by the points that
agree and that contradict, and without any: of a logistic regression on pairs of scans."""
MANY = 15.0
"""Walls and corners of which more tell no more."""
PAIR_AGREES, HARDLY = 0.15, 0.01
"""The same for two scans by themselves, and what is added to the share that contradicts."""
PAIR = np.array([6.7, 2.8, 2.5, -1.8, -13.6])
"""The same by the share of walls and corners that match, by how many do, by the points that agree,
by the logarithm of those that contradict, and without any."""
MEASURED = 2.4
"""What is added where the way is known in all directions."""


class View(NamedTuple):
    """Beams of an earlier scan, and the motion (3,) from its frame into that of the tracks."""

    beams: Beams
    motion: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judged:
    """Motions that were fitted to walls, and what walls and beams say of them.

    Attributes
    ----------
    motions : (k, 3) float64
    matches : list of Match
    agree, contradict : (k,) float64
        Share of the points that agree, in the view that agrees best, and that contradict, in all.
    match : (k,) float64
        How well walls agree, as a share of what could.
    surprise : (k,) float64
        How unlikely each motion is beforehand: log odds.
    """

    motions: NDArray[np.float64]
    matches: list[Match]
    agree: NDArray[np.float64]
    contradict: NDArray[np.float64]
    match: NDArray[np.float64]
    surprise: NDArray[np.float64]

    def and_those(self, more: Judged) -> Judged:
        """Return these motions and more."""
        return Judged(
            np.concatenate([self.motions, more.motions]),
            self.matches + more.matches,
            np.concatenate([self.agree, more.agree]),
            np.concatenate([self.contradict, more.contradict]),
            np.concatenate([self.match, more.match]),
            np.concatenate([self.surprise, more.surprise]),
        )

    @property
    def evidence(self) -> NDArray[np.float64]:
        """How likely each motion is right, (k,): log odds."""
        evidence = NONE + MATCHED * self.match + MATCHES * self._many - self.surprise
        evidence += AGREEING * self.agree + CONTRADICTING * self.contradict
        return np.where((self.agree >= AGREES) & (self._many > 0), evidence, -np.inf)

    @property
    def of_pair(self) -> NDArray[np.float64]:
        """Evidence of two scans alone for each motion, (k,): log odds, but for `MEASURED`."""
        against = np.log(self.contradict + HARDLY)
        told = [self.match, self._many, self.agree, against, np.ones(len(self.match))]
        known = (self.agree >= PAIR_AGREES) & (self._many > 0)
        return np.where(known, PAIR @ np.array(told), -np.inf)

    @property
    def _many(self) -> NDArray[np.float64]:
        return np.minimum([match.score for match in self.matches], MANY) / MANY


class Candidates(NamedTuple):
    """Motions of one scan into another that may be right, no two of them alike.

    Attributes
    ----------
    motions : (k, 3) float64
    evidence : (k,) float64
        Evidence of the two scans for each: log odds.
    measured : (k,) bool
        Whether the way is known in all directions.
    matches : list of Match
    """

    motions: NDArray[np.float64]
    evidence: NDArray[np.float64]
    measured: NDArray[np.bool_]
    matches: list[Match]
