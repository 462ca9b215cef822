"""Multiple-hypothesis evaluation of the motions of consecutive scans.

Each scan has several candidate motions from the one before.  A hypothesis selects one for each scan
of a run, or a break; the most likely hypotheses are kept from scan to scan (Reid, An algorithm for
tracking multiple targets, IEEE Trans. Automatic Control 24, 1979).  The likelihood of a motion is
that of the hypotheses that contain it, some scans later.

The weights were fitted to pairs of consecutive scans of ten logs of real lasers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.judging import Candidates
from relmap.planes.motions import others, then
from relmap.planes.odometry.prediction import Expected

MOST = 40
"""Maximum number of hypotheses."""
LATER = 3
"""Delay, in scans, after which a motion is judged."""
FOUND, PAIR = 4.8, 0.9
"""Log odds that some motion is right rather than a break, and weight of the evidence of the two
scans."""
BEFORE, LOWEST, HIGHEST = 0.35, -8.0, 10.0
"""Weight of the evidence of the scan before the last one for the motion from there, bounded."""
ASTRAY, AGAINST = -2.5, 0.38
"""The same for a motion that settles elsewhere, with the logarithm of the contradicting
fraction."""
HARDLY = 0.01
"""Constant added to that fraction."""
CHANGE, CHANGE_M, MOST_CHANGE = -0.7, 0.2, 1.5
"""Log likelihood of a change of the step, with heavy tails because robots stop; its scale; and the
limit if the previous motion is unknown."""
MARGIN = 15.0
"""Hypotheses less likely than the best by more than this, in log odds, are not evaluated
further."""

Judge = Callable[[Floats], tuple[float, float, bool]]
"""Evidence of a scan and the one two before for a motion (3,); see `Search.judged`."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Hypotheses of all scans up to one; h of them, likeliest first.

    `weight` (h,): log likelihood, up to a constant. `parent` (h,): parent hypothesis in the
    previous layer. `motion` (h, 3): the motion into the scan; NaN for a break.
    """

    weight: Floats
    parent: Ints
    motion: Floats


@dataclass(frozen=True, eq=False)
class Verdict:
    """Likelihood of the motions into one scan.

    `motions` (h, 3): motions of the hypotheses; NaN for a break. `share` (h,): fraction of the
    total likelihood.
    """

    motions: Floats
    share: Floats

    @property
    def best(self) -> Floats | None:
        """The motion (3,) of the most likely hypothesis with a motion; None if there is none."""
        known = np.isfinite(self.motions[:, 0])
        if not known.any():
            return None
        return np.asarray(self.motions[np.argmax(np.where(known, self.share, -1.0))])

    def odds(self, motion: Floats) -> float:
        """Return the log odds of a motion (3,)."""
        known = np.flatnonzero(np.isfinite(self.motions[:, 0]))
        share = self.share[known[~others(self.motions[known], motion)]].sum()
        return float(np.log(max(share, 1e-9)) - np.log(max(1 - share, 1e-9)))


class Hypotheses:
    """The most likely motions into the scans of a run, one scan after the other.

    `before` (3,): the motion into the first scan of the run; NaN if none is accepted.
    """

    def __init__(self, before: Floats) -> None:
        self._layers = [Layer(np.zeros(1), np.zeros(1, dtype=np.int64), before[None])]

    def go_on(
        self,
        found: Candidates,
        usual: Floats,
        judge: Judge | None,
        expected: Expected | None = None,
    ) -> None:
        """Add the candidates of the next scan.

        `usual` (3,): usual motion of the robot. `judge`: evidence of the scan two before; None if
        it has none. `expected`: motion expected from odometry; otherwise constant motion is
        assumed.
        """
        last = self._layers[-1]
        weight = last.weight[:, None] + FOUND + PAIR * found.evidence
        if expected:
            weight += expected.supports(found.motions)
        else:
            known = np.isfinite(last.motion[:, :1])
            step = np.where(known, last.motion[:, 1:], usual[1:])[:, None] - found.motions[:, 1:]
            change = np.log1p((step**2).sum(axis=2) / CHANGE_M**2)
            weight += CHANGE * np.where(known, change, np.minimum(change, MOST_CHANGE))
        best = max(weight.max(initial=-np.inf), last.weight.max())
        if judge:
            weight += _two_back(last, found, weight > best - MARGIN, judge)
        every = np.column_stack([last.weight, weight])
        order = np.argsort(-every.ravel(), kind="stable")[:MOST]
        parent, choice = np.divmod(order, every.shape[1])
        motions = np.concatenate([np.full((1, 3), np.nan), found.motions])
        self._layers.append(Layer(every.ravel()[order], parent, motions[choice]))

    def verdict(self, scan: int) -> Verdict:
        """Return the likelihood of the motions into a scan, counted from the first one."""
        last = self._layers[-1]
        row = np.arange(len(last.weight))
        for layer in reversed(self._layers[scan + 1 :]):
            row = layer.parent[row]
        share = np.exp(last.weight - last.weight.max())
        return Verdict(self._layers[scan].motion[row], share / share.sum())


def _two_back(last: Layer, found: Candidates, looked_at: Bools, judge: Judge) -> Floats:
    """Return the evidence of the scan two before for each motion and hypothesis; (h, k)."""
    weight = np.zeros(looked_at.shape)
    same: dict[bytes, list[int]] = {}
    for row in np.flatnonzero(np.isfinite(last.motion[:, 0])).tolist():
        same.setdefault(last.motion[row].tobytes(), []).append(row)
    for own in same.values():
        motion = last.motion[own[0]]
        for k in np.flatnonzero(looked_at[own].any(axis=0)).tolist():
            evidence, contradict, stays = judge(then(motion, found.motions[k]))
            weight[own, k] = BEFORE * np.clip(evidence, LOWEST, HIGHEST)
            if not stays or not np.isfinite(evidence):
                weight[own, k] = ASTRAY + AGAINST * (np.log(contradict + HARDLY) - np.log(HARDLY))
    return weight
