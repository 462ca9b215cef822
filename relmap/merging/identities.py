"""Labels and names of the landmarks of two maps of points that become one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Ints
from relmap.evaluation.metrics import positions_of
from relmap.io.results import Result

Texts = Sequence[str] | None


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
    None if they are numbers.
    """
    labels = a.landmarks.landmark, b.landmarks.landmark
    known = all(result.summary.get("association") == "known" for result in (a, b))
    if not known or (texts[0] is None) != (texts[1] is None):
        label = _fresh(labels[0], len(labels[1]))
        names = dict(enumerate(texts[0] or ()))
        named = {} if texts[1] is None else _called(label, labels[1], texts[1])
        return Identities(label, pairs, names | named)
    each = dict.fromkeys((*(texts[0] or ()), *(texts[1] or ())))
    number = {name: k for k, name in enumerate(each)}
    own = labels[1]
    if texts[1] is not None:
        own = np.array([number[texts[1][k]] for k in own.tolist()], dtype=np.int64)
    mine = positions_of(labels[0], own)
    alone = ~np.isin(np.arange(len(own)), pairs[:, 0])
    unplaced = ~(a.mapped[mine] & b.mapped) & ~np.isin(mine, pairs[:, 1])
    same = np.flatnonzero(alone & (mine >= 0) & unplaced)
    apart = alone & (mine >= 0) & ~unplaced
    others = np.concatenate([labels[0], own, list(number.values())])
    label = np.where(apart, _fresh(others, len(own)), own)
    n_apart = int(apart.sum() + (own[pairs[:, 0]] != labels[0][pairs[:, 1]]).sum())
    names = {k: name for name, k in number.items()}
    if texts[1] is not None:
        names |= _called(label[apart], labels[1][apart], texts[1])
    pairs = np.concatenate([pairs, np.column_stack([same, mine[same]])])
    return Identities(label, pairs, names, n_apart)


def _fresh(labels: Ints, n: int) -> Ints:
    return int(labels.max(initial=-1)) + 1 + np.arange(n)


def _called(label: Ints, number: Ints, texts: Sequence[str]) -> dict[int, str]:
    """Return the names of labels (n,) whose landmarks have a number (n,) among the texts."""
    return {int(at): texts[k] for at, k in zip(label, number.tolist(), strict=True)}
