"""Bags that are damaged, or cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.datasets import bags, open_scans
from tests.bagfiles import KINDS, RANGES, Types, beams, file_of, scanned, write_bag
from tests.logs import failure
from tests.scanlogs import failure as scan_failure


@pytest.mark.parametrize("packed", [*KINDS, "ros1-BZ2", "ros1-LZ4"])
@pytest.mark.parametrize("share", [0.5, 0.98])
def test_a_truncated_bag_is_read_up_to_the_damage(
    packed: str, share: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kind, _, packing = packed.partition("-")
    types, ranges = Types(kind), RANGES * 500
    scans = [("/scan", 2.0 + k, types.scan(2.0 + k, ranges, 0.0, 1e-4)) for k in range(400)]
    file = file_of(write_bag(tmp_path, kind, types, scans, packing))
    whole = file.read_bytes()
    file.write_bytes(whole[: round(share * len(whole))])
    log = open_scans(file)
    assert share - 0.25 < len(log) / 400 <= share + 0.02
    assert sum("damaged" in message for message in caplog.messages) == 1
    expected = beams(ranges, 0.0, 1e-4)
    assert all(np.allclose(scan.points_robot, expected, atol=1e-5) for scan in log.scans())


@pytest.mark.parametrize("kind", ["sqlite", "mcap"])
def test_a_recording_that_was_killed_has_no_metadata(kind: str, tmp_path: Path) -> None:
    types = Types(kind)
    path = write_bag(tmp_path, kind, types, scanned(types))
    (path / "metadata.yaml").unlink()
    assert len(open_scans(path)) == len(open_scans(file_of(path))) == 11


def test_invalid_poses_are_refused(tmp_path: Path) -> None:
    types = Types("mcap")
    odometry = types.odometry(1.0, np.eye(4))
    odometry.pose.pose.orientation.w = np.nan
    path = write_bag(tmp_path, "mcap", types, [("/odom", 1.0, odometry), *scanned(types)])
    message = scan_failure(path)
    assert f"{path}: topic /odom: position [" in message
    assert "expected finite numbers and a unit quaternion" in message


@pytest.mark.parametrize("kind", KINDS)
def test_without_rosbags_the_format_is_named(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    types = Types(kind)
    path = write_bag(tmp_path, kind, types, scanned(types))
    monkeypatch.setattr(bags, "find_spec", lambda name: None)
    for message in (failure(path), scan_failure(path)):
        assert f"is a ROS {1 if kind == 'ros1' else 2} bag" in message
        assert message.endswith("pip install 'relmap[bags]' to read it")
