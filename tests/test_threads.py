"""Maps are the same with one thread of BLAS or several."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from relmap import Plane3dMapper, PointMapper
from relmap.core.arrays import Floats
from relmap.simulation import simulate_figure_eight
from relmap.simulation.storey import simulate_storey
from tests.worlds import refined, seen


def mapped_points() -> Floats:
    log = simulate_figure_eight(density=92, iterations=200, dynamic=0.3).log
    return refined(PointMapper(), seen(log, known=False)).map.positions


def mapped_planes() -> Floats:
    mapper = refined(Plane3dMapper(), simulate_storey("lidar", 0.01, 10).scans)
    return np.column_stack([mapper.planes.normal, mapper.planes.offset])


def test_maps_do_not_depend_on_the_number_of_threads() -> None:
    for mapped in (mapped_points, mapped_planes):
        with threadpool_limits(1, "blas"):
            one = mapped()
        with threadpool_limits(2, "blas"):
            assert {each["num_threads"] for each in threadpool_info() if "blas" in str(each)} == {2}
            two = mapped()
            # `finish` and `refine` leave the number of threads as it was.
            assert {each["num_threads"] for each in threadpool_info() if "blas" in str(each)} == {2}
        np.testing.assert_array_equal(one, two)
