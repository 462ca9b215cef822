"""Arrays that grow: values are preserved, and little is reserved in advance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.state.growing import GrowingArray

STATUS = Path("/proc/self/status")


@pytest.mark.parametrize("room", [8, 16, 1000, 2**18])
def test_rows_are_kept_in_order_while_it_grows_and_drops(room: int) -> None:
    rng = np.random.default_rng(0)
    array: GrowingArray[np.float64] = GrowingArray(np.float64, (2,), room)
    expected = np.empty((0, 2))
    for _ in range(300):
        rows = rng.normal(size=(rng.integers(0, 40), 2))
        array.extend(rows)
        expected = np.concatenate([expected, rows])
        n = int(rng.integers(0, 20))
        array.drop(min(n, len(array)))
        expected = expected[n:]
        np.testing.assert_array_equal(array.values, expected)


def address_space_mb() -> float:
    """Return the address space of this process."""
    (line,) = (line for line in STATUS.read_text().splitlines() if line.startswith("VmSize"))
    return int(line.split()[1]) / 1024


@pytest.mark.skipif(not STATUS.exists(), reason="the system does not report address space")
def test_a_new_mapper_reserves_little_address_space() -> None:
    PointMapper()
    before = address_space_mb()
    mappers = [PointMapper() for _ in range(50)]
    assert address_space_mb() - before < 5 * len(mappers)
