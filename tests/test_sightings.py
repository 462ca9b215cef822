"""Which landmarks and tracks were seen in one scan."""

from __future__ import annotations

import numpy as np

from relmap import PointMapper
from relmap.core.association.reobservation.sightings import Sightings
from relmap.simulation import WorldSpec, simulate_world


def test_landmarks_that_were_seen_together() -> None:
    world, mapper = simulate_world(WorldSpec(length_m=200.0, iterations=80)), PointMapper()
    labels = [mapper.update(scan.points_robot) for scan in world.log.scans()]
    mapper.finish()
    table = mapper.engine.table
    sightings = Sightings(mapper.engine.rows, table)
    own = np.flatnonzero(table.weight > 0)
    shown = np.array([np.isin(own, mapper.landmarks_of(seen)) for seen in labels])
    together = (shown.T.astype(int) @ shown) > 0
    pairs = np.column_stack([np.arange(len(own) - 1), np.arange(1, len(own))])
    assert [sightings.together(*own[pair].tolist()) for pair in pairs] == [
        together[one, other] for one, other in pairs
    ]
    both = [together[one] & together[other] for one, other in pairs]
    expected = [b.sum() - b[one] - b[other] for b, (one, other) in zip(both, pairs, strict=True)]
    np.testing.assert_array_equal(sightings.seen_with_both(own[pairs], own), expected)
