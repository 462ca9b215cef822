"""The registrations beside the constellation: the paper's own, and known ids."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.arrays import Floats
from relmap.core.association import KnownAssociation, NearestPrevious
from tests.worlds import spacing

Points = Floats

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


def naive_nearest(scans: list[Points], gate_m: float | None) -> list[list[int]]:
    labels: list[list[int]] = []
    count = 0
    for k, now in enumerate(scans):
        before = scans[k - 1] if k else now[:0]
        limit = gate_m if gate_m is not None else np.inf
        if gate_m is None and len(before) > 1:
            limit = spacing(before) / 2
        row = []
        for i, point in enumerate(now):
            label = -1
            if len(before):
                j = int(np.argmin(np.linalg.norm(before - point, axis=1)))
                back = int(np.argmin(np.linalg.norm(now - before[j], axis=1)))
                if back == i and np.linalg.norm(before[j] - point) <= limit:
                    label = labels[k - 1][j]
            row.append(label)
        for i, label in enumerate(row):
            if label < 0:
                row[i], count = count, count + 1
        labels.append(row)
    return labels


@given(seeds, dimensions, st.sampled_from([None, 0.3, 1.0, 50.0]))
def test_nearest_previous_is_the_naive_mutual_search(
    seed: int, d: int, gate_m: float | None
) -> None:
    rng = np.random.default_rng(seed)
    scans = [rng.uniform(-2, 2, (n, d)) for n in rng.integers(0, 9, 5)]
    registration = NearestPrevious(gate_m)
    found = [registration.match(scan, None).tolist() for scan in scans]
    assert found == naive_nearest(scans, gate_m)
    numbers = set(itertools.chain(*found))
    assert numbers == set(range(len(numbers)))
    assert registration.labels_of(np.array([3, 0])).tolist() == [3, 0]


@pytest.mark.parametrize(("gate_m", "limit"), [(0.7, 0.7), (None, 1.0)])
def test_nearest_previous_stops_at_the_gate(gate_m: float | None, limit: float) -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [9.0, 9.0]])  # neighbours 2 apart
    for share, same in ((0.99, True), (1.01, False)):
        registration = NearestPrevious(gate_m)
        registration.match(square, None)
        moved = registration.match(square - share * limit / np.sqrt(2), None)
        assert moved.tolist() == ([0, 1, 2, 3] if same else [4, 5, 6, 7])


@given(st.lists(st.lists(st.integers(-3, 9), max_size=6, unique=True), max_size=8))
def test_known_ids_are_numbered_in_order_of_first_sight(scans: list[list[int]]) -> None:
    registration = KnownAssociation()
    order: list[int] = []
    for ids in scans:
        order += [i for i in ids if i >= 0 and i not in order]
        found = registration.match(np.zeros((len(ids), 2)), np.array(ids, dtype=np.int64))
        assert found.tolist() == [order.index(i) if i >= 0 else -1 for i in ids]
    assert registration.labels_of(np.arange(len(order))).tolist() == order
