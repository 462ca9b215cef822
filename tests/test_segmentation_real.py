"""Segmentation runs on scans of real logs, in time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from relmap import PlaneSegmenter
from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog


@pytest.mark.parametrize(
    ("log", "every", "least"),
    [
        ("mrpt-sim-laser2d/simul.scans.csv.gz", 2, 0.85),
        ("carmen-laser2d/freiburg-079-corrected.log.gz", 5, 0.6),
    ],
)
def test_laser_logs(
    real_scans: Callable[[str], ScanLog], log: str, every: int, least: float
) -> None:
    scans = real_scans(log)
    segmenter, times, share = PlaneSegmenter(), [], []
    for index in range(0, len(scans), every):
        points = scans.points_of(index)
        begin = process_time()
        segmenter.fit(points)
        times.append(process_time() - begin)
        planes = segmenter.planes_
        assert len(planes) > 0
        assert np.isfinite(planes.ends).all()
        assert (planes.size > 0).all()
        share.append((segmenter.labels_ >= 0).mean())
    assert np.median(times) < 20e-3
    assert np.mean(share) > least


def test_hall(shared_data: Path) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    scans = open_scans(shared_data / "lidar3d-hall")
    for index in (0, 16, 33):
        planes = PlaneSegmenter("patches").fit(scans.points_of(index)).planes_
        assert len(planes) >= 5
        assert planes.size.max() > 10, "the hall is 30 m wide"
        assert np.median(planes.noise) < 0.1
