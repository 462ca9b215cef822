"""Evidence of walls and beams for motions: log odds that each is right."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.planes.linking.placement import STILL, Match
from relmap.planes.motions import after
from relmap.planes.scans.beams import Beams

AGREES = 0.25
"""Smallest fraction of points that must agree."""
MATCHED, MATCHES, AGREEING, CONTRADICTING, NONE = 6.8, 4.2, 4.0, -57.0, -2.0
"""Coefficients of the log odds of a motion: fraction and number of matching walls, agreeing and
contradicting points, constant; from a logistic regression on pairs of scans."""
MANY = 15.0
"""Number of walls and corners above which the count saturates."""
PAIR_AGREES, HARDLY = 0.15, 0.01
"""The same for two scans alone, and the constant added to the contradicting fraction."""
PAIR = np.array([6.7, 2.8, 2.5, -1.8, -13.6])
"""Coefficients for two scans: fraction and number of matching walls and corners, agreeing points,
logarithm of the contradicting ones, constant."""
MEASURED = 2.4
"""Added if the motion is determined in all directions."""

NO_MATCH = Match(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), 0.0)


class View(NamedTuple):
    """Beams of an earlier scan, and the motion (3,) from its frame to that of the tracks.

    `scan`: its number, where that is needed.
    """

    beams: Beams
    motion: Floats
    scan: int = -1

    def then(self, motions: Floats) -> Floats:
        """Return motions (k, 3) from the frame of the tracks as those from that of the beams."""
        return motions if self.motion is STILL else after(self.motion, motions)


@dataclass(frozen=True, eq=False)
class Judged:
    """Motions fitted to walls, with the evidence of walls and beams.

    `motions` (k, 3); `agree`, `contradict` (k,): fraction of points that agree, in the best view,
    and that contradict, in all views; `match` (k,): agreement of the walls, as a fraction of the
    maximum; `surprise` (k,): prior improbability of each motion: log odds.
    """

    motions: Floats
    agree: Floats
    contradict: Floats
    match: Floats
    surprise: Floats
    matches: list[Match]

    def only(self, k: int) -> Judged:
        """Return one of these motions."""
        return Judged(*(getattr(self, column.name)[k : k + 1] for column in fields(self)))

    def and_those(self, more: Judged) -> Judged:
        """Return these motions and others."""
        columns: dict[str, Any] = {"matches": self.matches + more.matches}
        for name in ("motions", "agree", "contradict", "match", "surprise"):
            columns[name] = np.concatenate([getattr(self, name), getattr(more, name)])
        return Judged(**columns)

    @cached_property
    def evidence(self) -> Floats:
        """Log odds that each motion is right, (k,)."""
        evidence = NONE + MATCHED * self.match + MATCHES * self._many - self.surprise
        evidence += AGREEING * self.agree + CONTRADICTING * self.contradict
        return np.where((self.agree >= AGREES) & (self._many > 0), evidence, -np.inf)

    @cached_property
    def of_pair(self) -> Floats:
        """Evidence of two scans alone for each motion, (k,): log odds, without `MEASURED`."""
        against = np.log(self.contradict + HARDLY)
        features = [self.match, self._many, self.agree, against, np.ones(len(self.match))]
        known = (self.agree >= PAIR_AGREES) & (self._many > 0)
        return np.where(known, PAIR @ np.array(features), -np.inf)

    @cached_property
    def _many(self) -> Floats:
        return np.minimum([match.score for match in self.matches], MANY) / MANY


class Candidates(NamedTuple):
    """Distinct candidate motions of one scan into another.

    `motions` (k, 3); `evidence` (k,): evidence of the two scans for each: log odds; `measured`
    (k,): whether the motion is determined in all directions; `doubtful` (k,): whether too few
    points support it to tie the scans.
    """

    motions: Floats
    evidence: Floats
    measured: Bools
    doubtful: Bools
    matches: list[Match]


_EMPTY = np.empty(0, dtype=np.bool_)
NO_CANDIDATES = Candidates(np.empty((0, 3)), np.empty(0), _EMPTY, _EMPTY, [])


class Found(NamedTuple):
    """The accepted motion, and the resulting association.

    `measured`: whether the motion is determined in all directions; `evidence`: log odds that it is
    right; `bridged`: whether it is given by odometry only; `ambiguous`: whether only the usual step
    speaks against others along parallel walls.
    """

    motion: Floats
    match: Match
    measured: bool
    evidence: float
    bridged: bool = False
    ambiguous: bool = False
