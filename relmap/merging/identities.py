"""Labels and names of the landmarks of two maps of points that become one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Ints
from relmap.evaluation.metrics import positions_of
from relmap.io.results import Result

Texts = Mapping[int, str] | None


@dataclass(frozen=True, eq=False)
class Identities:
    """The identities of the landmarks of a merged map.

    `label` (n,): labels of the landmarks of the second map; `pairs` (k, 2): rows of the second and
    of the first that are one landmark, which keeps the label of the first; `names`: the name in the
    logs of each label that has one; `n_apart`: number of ids that mean different landmarks in the
    two maps.
    """

    label: Ints
    pairs: Ints
    names: dict[int, str]
    n_apart: int = 0


def identities_of(a: Result, b: Result, texts: tuple[Texts, Texts], pairs: Ints) -> Identities:
    """Return the identities, given the `pairs` (k, 2) of rows of `b` and `a` in one place.

    Landmarks of the second map keep their ids if both maps have ids, of the same kind, and the id
    is not that of a landmark of the first elsewhere. `texts`: what the ids of each map stand for,
    by label; None if they are numbers.
    """
    firsts, seconds = a.landmarks.landmark, b.landmarks.landmark
    known = all(result.summary.get("association") == "known" for result in (a, b))
    comparable = known and (texts[0] is None) == (texts[1] is None)
    own = _in_first(seconds, *texts) if comparable else np.full(len(seconds), -1)
    mine = positions_of(firsts, own)
    there = ~np.isin(np.arange(len(own)), pairs[:, 0]) & (mine >= 0)
    unplaced = ~(a.mapped[mine] & b.mapped) & ~np.isin(mine, pairs[:, 1])
    same, apart = np.flatnonzero(there & unplaced), there & ~unplaced
    n_other = int((own[pairs[:, 0]] != firsts[pairs[:, 1]]).sum())
    names = dict(texts[0] or {})
    fresh = max([*firsts.tolist(), *own.tolist(), *names], default=-1) + 1 + np.arange(len(own))
    label = np.where(apart | (own < 0), fresh, own)
    pairs = np.concatenate([pairs, np.column_stack([same, mine[same]])])
    rest = np.setdiff1d(np.arange(len(own)), pairs[:, 0])
    for at, number in zip(label[rest].tolist(), seconds[rest].tolist(), strict=True):
        if texts[1] is not None and number in texts[1]:
            names[at] = texts[1][number]
    return Identities(label, pairs, names, int(apart.sum()) + n_other if comparable else 0)


def _in_first(labels: Ints, first: Texts, second: Texts) -> Ints:
    """Return the labels (n,) of the second map as the first has them; -1 if it has no such text."""
    if first is None or second is None:
        return labels
    number = {text: k for k, text in first.items()}
    return np.array([number.get(second.get(k, ""), -1) for k in labels.tolist()], dtype=np.int64)
