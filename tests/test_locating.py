"""Scans found in a map of walls, and another log added to it: where it is clear, and only there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper, RelmapError
from relmap.cli import main
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import open_scans, write_scans_npz
from relmap.datasets.scans import ScanLog, SensorView
from relmap.evaluation.feeding import feed, preparation
from relmap.evaluation.sources import log_of
from relmap.mapper import Mapper, Place
from relmap.points import PointMapper
from relmap.simulation import Building, simulate_building
from relmap.simulation.visibility import seen_walls
from tests.commands import load, unrendered
from tests.everyformat import Mapped
from tests.worlds import ROOM


@pytest.fixture(scope="module")
def oblique() -> Building:
    """A building without right angles: few of its places look alike."""
    return simulate_building(181, 0.01, sampling="laser", world="oblique")


@pytest.fixture(scope="module")
def twins() -> Building:
    return simulate_building(181, 0.01, sampling="laser", world="twin-rooms", iterations=250)


def places(mapper: PlaneMapper, log: ScanLog, every: int) -> list[tuple[int, Place]]:
    prepare = preparation(mapper, log)
    scans = [scan for scan in log.scans() if scan.iteration % every == 0]
    found = [mapper.locate(prepare(s.points_robot), s.points_robot) for s in scans]
    return [(s.iteration, place) for s, place in zip(scans, found, strict=True)]


def test_scans_of_a_building_are_found_where_they_were_taken(oblique: Building) -> None:
    mapper, log = PlaneMapper(), log_of(oblique)
    feed(mapper, log, "nearest", refine=True)
    path = mapper.trajectory
    tried = places(mapper, log, 20)
    found = [k for k, place in tried if place.n_places == 1]
    assert len(found) >= len(tried) / 2
    for k, place in tried:
        if place.n_places == 1:
            assert np.abs(place.T_map_robot - path[k])[:2].max() < 0.1
    assert len(mapper.submaps) == 1
    np.testing.assert_array_equal(mapper.trajectory, path)


def test_identical_rooms_are_not_distinguished(twins: Building) -> None:
    mapper, log = PlaneMapper(), log_of(twins)
    feed(mapper, log, "nearest", refine=True)
    assert {place.n_places for _, place in places(mapper, log, 25)} == {2}


@pytest.fixture(scope="module")
def part(oblique: Building, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with scans, and the map of the first part of them."""
    folder = tmp_path_factory.mktemp("walls")
    points = [scan.points[:, :2] for scan in oblique.scans]
    view = SensorView(oblique.sensor.view_rad, oblique.sensor.range_m)
    write_scans_npz(folder / "scans.npz", points, oblique.stamps_s, view)
    asked = ["map", str(folder / "scans.npz"), "-o", str(folder / "part"), "--variant", "planes"]
    with unrendered():
        assert main([*asked, "--scans", "0:150"]) == 0
    return folder


@unrendered()
def test_a_log_is_added_to_a_map_of_walls(
    part: Path, oblique: Building, capsys: pytest.CaptureFixture[str]
) -> None:
    log, more = str(part / "scans.npz"), part / "more"
    asked = ["map", log, "-o", str(more), "--variant", "planes", "--scans", "60:200"]
    assert main([*asked, "--onto", str(part / "part")]) == 0
    assert "could not be localised" not in capsys.readouterr().out
    summary = load(more / "summary.json")
    assert summary["tied_at"] is not None
    assert [submap["scans"] for submap in summary["submaps"]] == [290]
    assert 60 not in summary["weak_links"]  # there is no step from one log to the next
    way_m = np.hypot(*np.diff(oblique.trajectory[:, :2, 3], axis=0).T)
    both_m = way_m[:149].sum() + way_m[60:199].sum()
    np.testing.assert_allclose(summary["submaps"][0]["metres"], both_m, rtol=0.02)
    first, both = (np.loadtxt(folder / "trajectory.tum") for folder in (part / "part", more))
    true = oblique.trajectory[:, :2, 3]
    R, t = fit_rigid(true[:150], first[:, 1:3])
    assert len(both) == 140
    off_m = np.hypot(*(both[:, 1:3] - (true[60:200] @ R.T + t)).T)
    assert np.median(off_m) < 0.15
    assert off_m.max() < 0.4
    counts = [load(folder / "summary.json")["counts"] for folder in (part / "part", more)]
    new, old = counts[1]["planes_static"], counts[0]["planes_static"]
    assert old < new < 1.6 * old  # those in both are one


@unrendered()
def test_a_log_that_refine_joins_keeps_the_frame_of_the_map(
    part: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is the larger submap."""
    few, more = str(part / "few"), str(part / "joined")
    asked = ["map", str(part / "scans.npz"), "--variant", "planes", "-o"]
    assert main([*asked, few, "--scans", "0:40"]) == 0
    assert main([*asked, more, "--scans", "20:80", "--onto", few]) == 0
    assert "could not be localised" not in capsys.readouterr().out
    summary = load(Path(more) / "summary.json")
    assert summary["tied_at"] == 20
    assert [submap["scans"] for submap in summary["submaps"]] == [100]
    first, both = (np.loadtxt(Path(folder) / "trajectory.tum") for folder in (few, more))
    np.testing.assert_allclose(both[:20], first[20:], atol=0.03)
    loaded = PlaneMapper.load(Path(more) / "mapper.npz")
    assert loaded.tied_at == 40
    np.testing.assert_allclose(loaded.trajectory[-len(both) :, :3, 3], both[:, 1:4], atol=1e-5)


@unrendered()
def test_a_log_of_another_place_is_a_separate_submap(
    part: Path, capsys: pytest.CaptureFixture[str], logs: Path
) -> None:
    out = part / "apart"
    asked = ["map", str(logs / "npz"), "-o", str(out), "--variant", "planes"]
    assert main([*asked, "--onto", str(part / "part")]) == 0
    assert "could not be localised" in capsys.readouterr().out
    summary = load(out / "summary.json")
    assert summary["tied_at"] is None
    assert sorted(submap["scans"] for submap in summary["submaps"]) == [16, 150]
    assert len(np.loadtxt(out / "submap-1.tum")) == 16


@unrendered()
def test_a_longer_log_of_another_place_does_not_displace_the_map(
    part: Path, capsys: pytest.CaptureFixture[str], logs: Path
) -> None:
    old, out = part / "short", part / "longer"
    asked = ["--variant", "planes", "-o"]
    assert main(["map", str(logs / "npz"), *asked, str(old)]) == 0
    new = [str(part / "scans.npz"), "--scans", "0:40"]
    assert main(["map", *new, *asked, str(out), "--onto", str(old)]) == 0
    printed = capsys.readouterr().out
    assert "that of the earlier map, of 16 scans" in printed
    assert "could not be localised" in printed
    assert [submap["scans"] for submap in load(out / "summary.json")["submaps"]] == [16, 40]
    assert len(np.loadtxt(out / "submap-1.tum")) == 40
    before, after = (PlaneMapper.load(folder / "mapper.npz") for folder in (old, out))
    np.testing.assert_allclose(after.trajectory[:16], before.trajectory, atol=1e-6)
    np.testing.assert_allclose(after.map.positions, before.map.positions, atol=1e-6)
    assert after.tied_at is None


def test_scans_are_localised_and_drawn_in_a_map_of_walls(
    part: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (part / "part" / "mapper.npz").read_bytes()
    asked = ["localise", str(part / "scans.npz"), "--map", str(part / "part")]
    assert main([*asked, "-o", str(part / "where"), "--scans", "100:160"]) == 0
    assert (part / "part" / "mapper.npz").read_bytes() == before
    printed = capsys.readouterr().out
    assert printed.startswith("found ")
    found, mapped = (np.loadtxt(part / name / "trajectory.tum") for name in ("where", "part"))
    assert len(found) >= 5
    own = found[np.isin(found[:, 0], mapped[:, 0])]
    off = own[:, 1:3] - mapped[np.searchsorted(mapped[:, 0], own[:, 0]), 1:3]
    assert np.abs(off).max() < 0.1
    assert (part / "where" / "map.png").stat().st_size > 10_000


@unrendered()
def test_scans_that_fit_in_several_places_are_counted(
    twins: Building, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = [scan.points[:, :2] for scan in twins.scans]
    view = SensorView(twins.sensor.view_rad, twins.sensor.range_m)
    log = str(tmp_path / "scans.npz")
    write_scans_npz(tmp_path / "scans.npz", points, twins.stamps_s, view)
    assert main(["map", log, "-o", str(tmp_path / "map"), "--variant", "planes"]) == 0
    capsys.readouterr()
    asked = ["localise", log, "--map", str(tmp_path / "map"), "-o", str(tmp_path / "where")]
    assert main([*asked, "--scans", "200:210"]) == 0
    assert "10 fit in more than one place and were refused" in capsys.readouterr().out


@pytest.mark.parametrize(("found", "warned"), [(0, False), (1, True), (2, False)])
@unrendered()
def test_a_map_of_places_that_look_alike_is_warned_of(
    found: int,
    warned: bool,
    part: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    there = [Place(np.eye(4), 1)] * found + [Place(np.full((4, 4), np.nan), 2)] * (4 - found)
    told = iter(there)
    monkeypatch.setattr(PlaneMapper, "locate", lambda *_, **__: next(told))
    asked = ["localise", str(part / "scans.npz"), "--map", str(part / "part")]
    assert main([*asked, "-o", str(tmp_path), "--scans", "100:104"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"found {found} of 4 scans in the map; {4 - found} fit in more than ")
    assert ("WARNING: more scans fit in several places" in printed) == warned


@pytest.mark.parametrize(("scale", "away"), [(1, ""), (100, r"\d{3}"), (0.01, r"0.0\d")])
@unrendered()
def test_scans_in_other_units_than_the_map_are_named(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, away: str
) -> None:
    log = open_scans(part / "scans.npz").between(0, 3)
    points = [scale * scan.points_robot for scan in log.scans()]
    write_scans_npz(tmp_path / "scans.npz", points, np.arange(3.0))
    asked = ["localise", str(tmp_path / "scans.npz"), "--map", str(part / "part")]
    assert main([*asked, "-o", str(tmp_path / "where")]) == 0
    said = capsys.readouterr()
    none = "found 0 of 3 scans in the map: a scan must show walls of the map, "
    assert said.out.startswith(none) == bool(away)
    told = re.search(
        rf"the points of the first scan are {away}[\d.]* m away in the median", said.err
    )
    assert ("in metres" in said.err) == bool(away) == (told is not None)


def test_no_scan_is_looked_for_in_a_map_without_a_wall(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    PlaneMapper().save(tmp_path / "mapper.npz")
    asked = ["localise", str(part / "scans.npz"), "--map", str(tmp_path)]
    assert main([*asked, "-o", str(tmp_path / "where")]) == 2
    assert "the map has no wall" in capsys.readouterr().err
    assert not (tmp_path / "where").exists()


def test_what_was_saved_is_loaded_whatever_its_variant(mapped: Mapped) -> None:
    points, walls = mapped("csv/observations.csv"), mapped("npz")
    assert type(Mapper.load(points / "mapper.npz")) is PointMapper
    assert type(Mapper.load(walls / "mapper.npz")) is PlaneMapper
    with pytest.raises(RelmapError, match="holds a map of walls, not a map of points"):
        PointMapper.load(walls / "mapper.npz")


def test_an_empty_map_has_no_places() -> None:
    room = seen_walls(ROOM - [1.5, 1.0], 8.0, 3.0)
    mapper = PlaneMapper()
    assert mapper.locate(room, np.zeros((1, 2))).n_places == 0
    assert not mapper.take_up(room, np.zeros((1, 2)))


def test_a_journal_is_kept_from_the_beginning(tmp_path: Path) -> None:
    mapper = PlaneMapper(journal=tmp_path / "run.journal")
    with pytest.raises(RelmapError, match="begins with an empty map"):
        mapper.take_up(seen_walls(ROOM - [1.5, 1.0], 8.0, 3.0))
    mapper.close()


def test_real_scans_are_found_where_the_robot_comes_again(
    real_scans: Callable[[str], ScanLog],
) -> None:
    """Freiburg 079, judged by the poses in the log: none may be wrong."""
    log = real_scans("carmen-laser2d/freiburg-079-corrected.log.gz")
    mapper = PlaneMapper()
    feed(mapper, log.between(0, 300), "nearest", refine=True)
    R, t = fit_rigid(log.poses[:300, :2, 3], mapper.trajectory[:, :2, 3])
    again = {*range(2134, 2170, 4), *range(3539, 3580, 4), *range(4655, 4728, 6)}
    found = 0
    prepare = preparation(mapper, log)
    for k in sorted(again | {*range(600, 4700, 300)}):
        (scan,) = log.between(k, k + 1).scans()
        place = mapper.locate(prepare(scan.points_robot), scan.points_robot)
        if place.n_places == 1:
            found += 1
            off = place.T_map_robot[:2, 3] - (R @ log.poses[k, :2, 3] + t)
            assert np.hypot(*off) < 0.4, k
    assert found >= 5
