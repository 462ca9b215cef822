"""Saved maps: nothing is lost, and no file executes code when it is loaded."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import MapperConfig, PlaneMapper, PlaneSegmenter, PointMapper, RelmapError
from relmap.cli import main
from relmap.datasets import write_observation_csv
from relmap.simulation import simulate_building, simulate_figure_eight
from tests.commands import load, table
from tests.savedmaps import saved_map, told
from tests.worlds import finished, walk

pytestmark = pytest.mark.usefixtures("unrendered")


def ended(mapper: Any) -> tuple[bytes, ...]:
    mapper.finish()
    before = told(mapper)
    mapper.refine()
    return (*before, *told(mapper))


@pytest.mark.parametrize(
    ("settings", "dimension", "with_ids"),
    [
        (MapperConfig(), 3, False),
        (MapperConfig(group_after=6, keep_observations=True), 2, True),
        (MapperConfig(registration="nearest-previous"), 3, False),
    ],
)
def test_a_loaded_run_continues_identically(
    tmp_path: Path, settings: MapperConfig, dimension: int, with_ids: bool
) -> None:
    scans = walk(dimension, 3, 0.02).scans
    plain, saved = PointMapper(settings), PointMapper(settings)
    for k, (ids, points) in enumerate(scans):
        if k in (0, 1, 9, 30, 31, 77):
            saved.save(tmp_path / "mapper.npz")
            saved = PointMapper.load(tmp_path / "mapper.npz")
            assert saved.n_iterations == k
            assert told(saved) == told(plain)
        known = ids if with_ids else None
        np.testing.assert_array_equal(saved.update(points, known), plain.update(points, known))
    assert saved.config == settings
    assert ended(saved) == ended(plain)
    saved.save(tmp_path / "mapper.npz")
    assert told(PointMapper.load(tmp_path / "mapper.npz")) == told(plain)


def test_the_live_refinement_goes_on(tmp_path: Path) -> None:
    scans = list(simulate_figure_eight(seed=2).log.scans())[:600]
    plain, saved = PointMapper(), PointMapper()
    for k, scan in enumerate(scans):
        if k >= 360 and k % 40 == 0:  # before and after its first steps
            saved.save(tmp_path / "mapper.npz")
            saved = PointMapper.load(tmp_path / "mapper.npz")
        plain.update(scan.points_robot, scan.ids)
        saved.update(scan.points_robot, scan.ids)
    assert told(saved) == told(plain)


def test_walls_go_on_too(tmp_path: Path) -> None:
    scans = [scan.seen for scan in simulate_building(seed=0, points=20, iterations=90).scans]
    plain, saved = PlaneMapper(), PlaneMapper(segmenter=PlaneSegmenter())
    for k, scan in enumerate(scans):
        if k in (0, 40, 41):
            saved.save(tmp_path / "mapper.npz")
            saved = PlaneMapper.load(tmp_path / "mapper.npz")
        np.testing.assert_array_equal(saved.update(scan), plain.update(scan))
    assert ended(saved) == ended(plain)
    saved.save(tmp_path / "mapper.npz")
    again = PlaneMapper.load(tmp_path / "mapper.npz")
    assert told(again) == told(plain)
    assert again.planes.ends.tobytes() == plain.planes.ends.tobytes()


def test_the_same_state_gives_the_same_bytes(tmp_path: Path) -> None:
    path = saved_map(tmp_path)
    before = path.read_bytes()
    PointMapper.load(path).save(path)
    again = path.read_bytes()
    assert len(again) == len(before)
    PointMapper.load(path).save(path)
    assert path.read_bytes() == again


def test_saved_maps_of_another_kind_are_refused(tmp_path: Path) -> None:
    path = saved_map(tmp_path)
    with pytest.raises(RelmapError, match="holds a map of points, not a map of walls"):
        PlaneMapper.load(path)
    with pytest.raises(RelmapError, match="there is no saved map"):
        PointMapper.load(tmp_path / "none.npz")
    with pytest.raises(RelmapError, match="cannot write"):
        PointMapper().save(tmp_path / "none" / "mapper.npz")
    np.savez(path, graph=np.array([None], dtype=object))
    with pytest.raises(RelmapError, match="is damaged or not a saved map"):
        PointMapper.load(path)
    path.write_text("iteration,x,y\n")
    with pytest.raises(RelmapError, match="is damaged or not a saved map"):
        PointMapper.load(path)


def test_tables_and_columns_go_by_what_they_hold(tmp_path: Path) -> None:
    with np.load(saved_map(tmp_path)) as content:
        names = set(content)
    assert {
        *("landmarks/position", "landmarks/submap", "observations/columns/location"),
        *("segments/points", "association/registration/tracks/expected"),
        *("schedule/in_view", "groups/mapped/landmarks"),
    } <= names
    assert not any("_model" in name or "relmap" in name or "/_" in name for name in names)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log of an eight, a map of its first part, and one of all of it."""
    folder = tmp_path_factory.mktemp("tour")
    write_observation_csv(folder / "log.csv", simulate_figure_eight(seed=4).log)
    log = str(folder / "log.csv")
    assert main(["map", log, "-o", str(folder / "part"), "--scans", "0:450"]) == 0
    return folder


def test_scans_that_are_joined_to_a_map_need_not_be_localised(
    tour: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, few = table(tour / "log.csv"), tour / "few.csv"
    rows = [row for row in rows if 330 <= int(row["iteration"]) < 370]
    names, seen = list(rows[0]), Counter[str]()
    with few.open("w") as file:
        file.write(",".join(names) + "\n")
        for row in rows:
            seen[row["iteration"]] += 1
            if seen[row["iteration"]] <= 6:  # one fewer than it takes
                file.write(",".join(row.values()) + "\n")
    assert main(["map", str(few), "-o", str(tour / "few"), "--onto", str(tour / "part")]) == 0
    assert "could not be localised" not in capsys.readouterr().out
    first = np.loadtxt(tour / "few" / "trajectory.tum")[0, 0]
    assert load(tour / "few" / "summary.json")["tied_at"] == first


def test_a_log_is_added_to_a_map(tour: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, part, more = str(tour / "log.csv"), str(tour / "part"), str(tour / "more")
    assert main(["map", log, "-o", more, "--scans", "300:700", "--onto", part]) == 0
    assert "could not be localised" not in capsys.readouterr().out
    summary = load(tour / "more" / "summary.json")
    assert summary["tied_at"] == 300
    assert len(summary["submaps"]) == 1
    before, after = (table(tour / name / "landmarks.csv") for name in ("part", "more"))
    mapped = {row["landmark"]: row for row in after if row["status"] == "static"}
    assert len(mapped) > len(before) + 20
    shared = [row for row in before if row["landmark"] in mapped]
    assert len(shared) >= 0.95 * len(before)
    away = [
        [float(row[axis]) - float(mapped[row["landmark"]][axis]) for axis in "xyz"]
        for row in shared
        if row["x"]
    ]
    assert np.linalg.norm(away, axis=1).max() < 0.5
    assert len((tour / "more" / "trajectory.tum").read_text().splitlines()) == 401


@pytest.mark.parametrize("association", ["nearest", "known"])
def test_a_longer_log_of_another_place_does_not_displace_the_map(
    tmp_path: Path, association: str
) -> None:
    for name, seed, iterations, first_id in (("old", 1, 60, 0), ("new", 2, 120, 1000)):
        log = simulate_figure_eight(iterations=iterations, seed=seed).log
        write_observation_csv(tmp_path / f"{name}.csv", replace(log, ids=log.ids + first_id))
    old, new, both = (str(tmp_path / name) for name in ("old", "new", "both"))
    asked = ["--association", association, "-o"]
    assert main(["map", f"{old}.csv", *asked, old]) == 0
    assert main(["map", f"{new}.csv", *asked, both, "--onto", old]) == 0
    summary = load(tmp_path / "both" / "summary.json")
    assert summary["tied_at"] is None
    assert summary["refinement"]["anchor_iteration"] == -60
    before, after = (PointMapper.load(tmp_path / name / "mapper.npz") for name in ("old", "both"))
    assert len(after.submaps[1].landmark_ids) > len(after.map.landmark_ids)
    np.testing.assert_array_equal(after.map.landmark_ids, before.map.landmark_ids)
    np.testing.assert_allclose(after.map.positions, before.map.positions, atol=1e-6)


def test_scans_are_found_in_a_map_that_stays_as_it_is(tour: Path) -> None:
    part, where = tour / "part", tour / "where"
    before = (part / "mapper.npz").read_bytes()
    asked = ["localise", str(tour / "log.csv"), "--map", str(part), "-o", str(where)]
    assert main([*asked, "--scans", "0:440"]) == 0
    assert (part / "mapper.npz").read_bytes() == before
    found = np.loadtxt(where / "trajectory.tum")
    mapped = np.loadtxt(part / "trajectory.tum")
    assert len(found) >= 0.9 * 440
    off = found[:, 1:4] - mapped[np.searchsorted(mapped[:, 0], found[:, 0]), 1:4]
    assert np.linalg.norm(off, axis=1).max() < 0.5


def test_localise_in_the_plane_and_of_what_is_nowhere() -> None:
    world = walk(2, 3, 0.01, iterations=150)
    mapper = finished(PointMapper(), (points for _, points in world.scans))
    before = told(mapper)
    poses = np.array([mapper.localise(points) for _, points in world.scans])
    there = np.isfinite(poses[:, 0, 0])
    assert there.mean() > 0.3  # a walk sees some eight landmarks, the first and last ones fewer
    assert np.abs(poses - mapper.trajectory)[there].max() < 0.1
    rng = np.random.default_rng(0)
    assert np.isnan([mapper.localise(rng.uniform(-8, 8, (9, 2))) for _ in range(20)]).all()
    assert np.isnan(mapper.localise([])).all()
    assert np.isnan(PointMapper().localise([[1.0, 2.0, 3.0]])).all()
    assert told(mapper) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--onto", "part", "--journal", "run.journal"],
            "--journal records a run from its beginning",
        ),
        (["--onto", "part", "--variant", "planes"], "is a landmark log"),
        (["--onto", "part", "--registration", "constellation"], "give no others"),
        (["--onto", "nowhere"], "there is no saved map"),
    ],
)
def test_options_incompatible_with_onto(
    tour: Path,
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tour)
    assert main(["map", "log.csv", "-o", "none", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tour / "none").exists()
