"""Along corridors with doors, seen by a coarse laser, beams prefer none of several places."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.evaluation.feeding import feed
from relmap.evaluation.metrics import ate
from relmap.evaluation.sources import log_of
from relmap.simulation import simulate_building
from relmap.simulation.sensor import Sensor


@pytest.mark.parametrize(("beams", "seed"), [(91, 5), (91, 9), (61, 11)])
def test_the_usual_step_decides_between_places_along_a_corridor(beams: int, seed: int) -> None:
    log = log_of(
        simulate_building(
            beams,
            0.02,
            world="corridor",
            sampling="laser",
            step_m=0.5,
            sensor=Sensor(8.0, np.pi),
            iterations=100,
            seed=seed,
        )
    )
    mapper = PlaneMapper()
    feed(mapper, log, "nearest")
    assert log.poses is not None
    largest = max(mapper.submaps, key=lambda submap: len(submap.poses))
    assert len(largest.poses) > 90
    assert ate(largest.poses, log.poses[slice(*largest.span)], planar=True) < 0.22
