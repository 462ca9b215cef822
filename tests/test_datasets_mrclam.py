"""MRCLAM in small and as it is: images, robots, odometry, truth."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.odometry import checked_odometry, motion_from_velocity
from relmap.datasets import open_log
from relmap.datasets.base import ObservationLog
from relmap.datasets.mrclam import APART_S, read_ground_truth
from relmap.evaluation.truth import read_truth
from tests.logs import failure, put

CODES = "# Subject # Barcode #\n1 5\n2 14\n6 63\n7 81\n8 7\n"
FIRST = (
    "# Time Subject range bearing\n10.5 63 2 1.5707963267948966\n10.5 81 3 0\n10.6 14 1 0\n"
    "10.7 99 1 0\n12.5 63 4 -1.5707963267948966\n12.5 63 5 0\n11 7 1 3.141592653589793\n"
)
SECOND = "10 81 2 0\n"
WHEELS = "10 0.5 0.1\n10.75 1 0\n11.75 0.5 -0.2\n13 0 0\n"
VICON = "10 0 0 0\n11 1 0 0.2\n12 2 0 0.4\n13 2 1 0.6\n"
PLACES = "6 1 2 0.001 0.002\n7 3 4 0.001 0.002\n8 5 6 0.001 0.002\n"


@pytest.fixture
def robots(tmp_path: Path) -> Path:
    put(tmp_path, CODES, "Barcodes.dat")
    put(tmp_path, FIRST, "Robot1_Measurement.dat")
    put(tmp_path, WHEELS, "Robot1_Odometry.dat")
    put(tmp_path, VICON, "Robot1_Groundtruth.dat")
    put(tmp_path, gzip.compress(SECOND.encode()), "Robot2_Measurement.dat.gz")
    put(tmp_path, PLACES, "Landmark_Groundtruth.dat")
    return tmp_path


def test_rows_of_one_time_are_an_image(robots: Path) -> None:
    log = open_log(robots / "Robot1_Measurement.dat")
    assert log.iteration.tolist() == [0, 0, 1, 2]
    assert log.ids.tolist() == [6, 7, 8, 6]
    assert log.rows.tolist() == [0, 1, 6, 4]
    assert_allclose(log.points_robot, [[0, 2], [3, 0], [-1, 0], [0, -4]], atol=1e-12)
    assert log.stamps_s.tolist() == [10.5, 11, 12.5]


def test_velocities_add_up_between_images(robots: Path) -> None:
    odometry = open_log(robots / "Robot1_Measurement.dat").odometry
    arcs = [(0.5, 0.1, 0.25), (1.0, 0.0, 0.25), (1.0, 0.0, 0.75), (0.5, -0.2, 0.75)]
    a, b, c, d = (checked_odometry(motion_from_velocity(*arc)) for arc in arcs)
    assert np.isnan(odometry[0]).all()
    assert_allclose(odometry[1:], [a @ b, c @ d], atol=1e-12)


def test_the_folder_is_one_robot_after_another(robots: Path) -> None:
    log = open_log(robots)
    assert log.iteration.tolist() == [0, 0, 1, 2, 3]
    assert log.ids.tolist() == [6, 7, 8, 6, 7]
    assert log.rows.tolist() == [0, 1, 6, 4, 7]
    assert log.stamps_s.tolist() == [10.5, 11, 12.5, 10 + APART_S]
    assert np.isnan(log.odometry).all(axis=(1, 2)).tolist() == [True, False, False, True]
    assert open_log(robots / "Robot2_Measurement.dat.gz").odometry is None


def test_truth_is_at_the_images(robots: Path) -> None:
    truth = read_truth(robots)
    assert truth.landmark_ids.tolist() == [6, 7, 8]
    assert truth.landmarks_map.tolist() == [[1, 2, 0], [3, 4, 0], [5, 6, 0]]
    assert truth.stamps_s.tolist() == [10.5, 10.6, 10.7, 11, 12.5]
    assert_allclose(truth.poses[[0, 3, 4], :2, 3].ravel(), [0.5, 0.0, 1.0, 0.0, 2.0, 0.5])
    assert_allclose(truth.poses[4], checked_odometry([2, 0.5, 0.5]), atol=1e-12)
    assert len(read_truth(robots / "Robot1_Measurement.dat").poses) == 5


@pytest.mark.parametrize(
    ("name", "content", "parts"),
    [
        ("Barcodes.dat", CODES + "9 5\n", ["bar code 5 is duplicated"]),
        ("Barcodes.dat", "1 2 3\n", ["line 1", "2 numbers: subject bar code"]),
        ("Robot1_Measurement.dat", "10 63 2\n", ["line 1", "4 numbers: t bar-code range bearing"]),
        ("Robot1_Measurement.dat", "# nothing\n", ["holds no measurement"]),
        ("Robot1_Odometry.dat", "10 x 2\n", ["line 1", "3 numbers: t forward angular"]),
    ],
)
def test_damaged_files(robots: Path, name: str, content: str, parts: list[str]) -> None:
    put(robots, content, name)
    message = failure(robots)
    for part in [name, *parts]:
        assert part in message


def test_without_a_landmark_there_is_no_log(robots: Path) -> None:
    put(robots, "1 63\n2 81\n3 7\n", "Barcodes.dat")
    assert "no bar code is that of a landmark" in failure(robots)
    put(robots, "10 0 0\n", "Robot1_Groundtruth.dat")
    with pytest.raises(RelmapError, match=r"Robot1_Groundtruth.dat: line 1: .* 4 numbers"):
        read_truth(robots)


def test_robots_of_other_days_are_not_one_log(robots: Path) -> None:
    put(robots, gzip.compress(b"-200000 81 2 0\n"), "Robot2_Measurement.dat.gz")
    assert "robots are days apart" in failure(robots)


def seen_in_the_map(log: ObservationLog, folder: Path) -> tuple[Floats, Floats]:
    """Return how far each observation is off its landmark, and each motion off Vicon's (k, 2)."""
    ids, places, stamps_s, poses = read_ground_truth(folder)
    at = np.searchsorted(stamps_s, log.stamps_s).clip(0, len(stamps_s) - 1)
    known = stamps_s[at] == log.stamps_s
    rows = known[log.iteration]
    T = poses[at[log.iteration[rows]]]
    in_map = np.einsum("nij,nj->ni", T[:, :2, :2], log.points_robot[rows]) + T[:, :2, 3]
    true = places[np.searchsorted(ids, log.ids[rows])]
    k = np.flatnonzero(known[1:] & known[:-1] & (np.diff(log.stamps_s) < 60)) + 1
    moved = np.linalg.inv(poses[at[k - 1]]) @ poses[at[k]]
    off = (moved - log.odometry[k])[:, [0, 1], [3, 0]]
    there = np.isfinite(off).all(axis=1)
    return np.linalg.norm(in_map - true[:, :2], axis=1), off[there]


def test_the_data_set_agrees_with_its_truth(shared_data: Path) -> None:
    folder = shared_data / "mrclam-dataset6"
    sightings, images = [1534, 3239, 4348, 2023, 4239], [1012, 1985, 2279, 1216, 2325]
    log = open_log(folder / "Robot1_Measurement.dat.gz")
    assert (len(log.points_robot), len(log)) == (sightings[0], images[0])
    log = open_log(folder)
    # The robots follow one another.
    before = np.searchsorted(log.iteration, np.cumsum(images))
    assert before.tolist() == np.cumsum(sightings).tolist()
    assert len(log) == sum(images)
    far, off = seen_in_the_map(log, folder)
    assert len(far) > 15_300
    assert 0.08 < np.median(far) < 0.14
    assert len(off) > 8_700
    assert np.median(np.abs(off), axis=0).max() < 0.006


def test_what_is_sorted_or_left_out_is_reported(
    robots: Path, caplog: pytest.LogCaptureFixture
) -> None:
    put(robots, "".join(reversed(WHEELS.splitlines(keepends=True))), "Robot1_Odometry.dat")
    open_log(robots / "Robot1_Measurement.dat")
    seen, wheels = robots / "Robot1_Measurement.dat", robots / "Robot1_Odometry.dat"
    assert caplog.messages == [
        f"{seen}: 1 measurements out of order: all are sorted by time",
        f"{seen}: 1 unknown bar codes are left out",
        f"{wheels}: 3 velocities out of order: all are sorted by time",
    ]
