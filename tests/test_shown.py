"""How mappers and tables are displayed: texts, frames, pictures, folders."""

from __future__ import annotations

import subprocess
import sys
from operator import methodcaller
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from sklearn.base import clone

import relmap
from relmap import PlaneMapper, PlaneSegmenter, PointMapper, RelmapError
from relmap.core.landmarks import LandmarkMap
from relmap.core.shown import Table
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.planes.walls.files import PlaneResult, read_any
from relmap.simulation import building_scene, simulate_building, simulate_figure_eight
from tests.commands import load, names, table
from tests.everyformat import Mapped

HTML: Any = methodcaller("_repr_html_")


@pytest.fixture(scope="module")
def points(mapped: Mapped) -> PointMapper:
    return PointMapper.load(mapped("csv/observations.csv") / "mapper.npz")


@pytest.fixture(scope="module")
def walls(mapped: Mapped) -> PlaneMapper:
    return PlaneMapper.load(mapped("npz") / "mapper.npz")


def test_mappers_and_tables_print_their_content(points: PointMapper, walls: PlaneMapper) -> None:
    assert repr(points).startswith("PointMapper(30 iterations, 12 landmarks mapped, ")
    assert repr(PointMapper()) == "PointMapper(0 iterations, 0 landmarks mapped)"
    assert repr(walls).startswith("PlaneMapper(16 iterations, ")
    assert len(points.map) == len(points.landmarks) == 12
    assert repr(points.landmarks).startswith("LandmarkTable(12 rows, 12 static; landmark, x, ")
    assert len(walls.planes) == len(walls.planes.plane)
    assert len(LandmarkMap(np.empty(0, np.int64), np.empty((0, 3)))) == 0


def test_records_of_arrays_print_shapes_and_not_their_numbers(walls: PlaneMapper) -> None:
    world, building = simulate_figure_eight(iterations=30), simulate_building(100, iterations=5)
    log, truth = world.log, truth_of(world)
    run = run_mapper(PointMapper(), log, refine=True)
    assert repr(log).startswith(f"ObservationLog(points_robot=({len(log.iteration)}, 3) float64, ")
    assert "iteration=3, points_robot=(" in repr(log.between(3, 4).scans().__next__())
    assert "scans=list of 5" in repr(building)
    assert "landmarks=LandmarkTable of " in repr(run)
    assert "assembled=Assembled(...)" in repr(walls.submaps[0])
    for record in (world, log, truth, building, run, run.result, walls.submaps[0]):
        assert len(repr(record)) < 500
        assert "array(" not in repr(record)


def test_notebooks_show_the_first_rows_and_no_html_of_others(points: PointMapper) -> None:
    shown = HTML(points.landmarks)
    assert shown.count("<tr>") == 11
    assert "<td>static</td>" in shown
    assert repr(points) in HTML(points)
    points.landmarks.status[0] = "static"
    odd = LandmarkMap(np.array([3]), np.array([[1.0, np.nan, 1e-9]]))
    assert "<td>nan</td>" in HTML(odd)


@pytest.mark.parametrize("source", ["csv/observations.csv", "npz"])
def test_frames_have_the_columns_of_the_files(mapped: Mapped, source: str) -> None:
    pytest.importorskip("pandas")
    folder = mapped(source)
    kind = PlaneMapper if source == "npz" else PointMapper
    mapper = kind.load(folder / "mapper.npz")
    files: dict[str, Table] = {"landmarks.csv": mapper.landmarks}
    if isinstance(mapper, PlaneMapper):
        files["planes.csv"] = mapper.planes
    for name, of in files.items():
        frame, rows = of.to_dataframe(), table(folder / name)
        assert set(frame.columns) <= set(rows[0])
        assert len(frame) == len(rows) == len(of)
        for column in frame.columns:
            for value, text in zip(frame[column].tolist(), (r[column] for r in rows), strict=True):
                told = "" if value != value else str(value)
                assert told == text or float(told) == float(text)
    frame = mapper.map.to_dataframe()
    np.testing.assert_array_equal(frame[["x", "y", "z"]].to_numpy(), mapper.map.positions)
    np.testing.assert_array_equal(frame["cxy"], mapper.map.covariances[:, 0, 1])


def test_a_frame_needs_pandas(points: PointMapper, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(RelmapError, match="pandas"):
        points.map.to_dataframe()


def test_map_and_table_agree(points: PointMapper) -> None:
    mapped = np.isfinite(points.landmarks.positions[:, 0])
    np.testing.assert_array_equal(points.landmarks.landmark_ids[mapped], points.map.landmark_ids)
    np.testing.assert_array_equal(points.landmarks.positions[mapped], points.map.positions)


def test_the_map_is_drawn(points: PointMapper, walls: PlaneMapper) -> None:
    for mapper in (points, walls, PointMapper(), PlaneMapper()):
        figure = mapper.plot()
        assert isinstance(figure, Figure)
        figure.draw_without_rendering()
    (axes,) = walls.plot().axes
    assert axes.get_title().startswith(f"{(walls.planes.status == 'static').sum()} walls")


@pytest.mark.parametrize("source", ["csv/observations.csv", "flat", "npz"])
def test_saved_results_are_those_of_the_command_line(
    mapped: Mapped, tmp_path: Path, source: str
) -> None:
    folder = mapped(source)
    kind = PlaneMapper if source == "npz" else PointMapper
    kind.load(folder / "mapper.npz").save_results(tmp_path / "new")
    # Another test may have evaluated this result before.
    missing = {"evaluation.json", "bench.png"} if source == "npz" else {"evaluation.json"}
    assert set(names(tmp_path / "new")) == set(names(folder)) - missing
    same = ["landmarks.csv", "map.ply", "submaps.csv", "mapper.npz", "trajectory.tum"]
    for name in [*same, *(["planes.csv"] if source == "npz" else [])]:
        assert (tmp_path / "new" / name).read_bytes() == (folder / name).read_bytes()
    ours, theirs = (load(each / "summary.json") for each in (tmp_path / "new", folder))
    for name in ("configuration", "dimensions", "scans", "refinement", "submaps", "refined"):
        assert ours[name] == theirs[name]
    assert set(ours["counts"].items()) <= set(theirs["counts"].items())
    assert table(tmp_path / "new" / "tracks.csv.gz") == []


def test_other_objects_than_logs_are_not_mapped() -> None:
    frame: Any = {"x": [1.0]}
    with pytest.raises(RelmapError, match="got a dict, expected a log"):
        relmap.map_log(frame)


def test_saved_results_replace_those_of_another_kind(
    points: PointMapper, walls: PlaneMapper, tmp_path: Path
) -> None:
    """Nothing is left of them that would be read as part of the new one."""
    walls.save_results(tmp_path)
    for name in ("evaluation.json", "names.csv", "submap-1.tum"):
        (tmp_path / name).write_text("of the walls")
    points.save_results(tmp_path)
    points.save_results(tmp_path / "new")
    assert set(names(tmp_path)) == {*names(tmp_path / "new"), "new"}
    assert not isinstance(read_any(tmp_path), PlaneResult)


def test_mappers_of_nothing_are_saved(tmp_path: Path) -> None:
    for mapper in (PointMapper(), PlaneMapper()):
        mapper.save_results(tmp_path)
        assert load(tmp_path / "summary.json")["scans"] == [0, 0]
    blocked = tmp_path / "summary.json" / "folder"
    with pytest.raises(RelmapError, match="cannot write"):
        PointMapper().save_results(blocked)


def test_packages_are_there_without_a_separate_import(child_env: dict[str, str]) -> None:
    code = (
        "import sys, relmap; assert 'relmap.simulation' not in sys.modules;"
        "print(relmap.simulation.simulate_figure_eight, relmap.datasets.open_log, dir(relmap));"
        "print([getattr(relmap, name) for name in dir(relmap)])"
    )
    run = [sys.executable, "-c", code]
    told = subprocess.run(run, env=child_env, capture_output=True, text=True, check=True).stdout
    assert "'evaluation'" in told
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        _ = relmap.nonsense


def test_a_segmenter_is_cloned_and_predicts_as_in_scikit_learn() -> None:
    segmenter = PlaneSegmenter("em", noise=0.02, random_state=3)
    assert repr(segmenter) == "PlaneSegmenter(method='em', noise=0.02, random_state=3)"
    again = clone(segmenter)
    assert again is not segmenter
    assert again.get_params() == segmenter.get_params()
    points = building_scene(seed=0).points
    np.testing.assert_array_equal(again.fit_predict(points), segmenter.fit(points).labels_)
    assert repr(again.planes_).startswith(f"Planes({len(again.planes_)} rows; x, y, z, nx, ny, x0")
    assert again.set_params(noise=0.05).noise == 0.05
    with pytest.raises(RelmapError, match="no parameter 'sigma'"):
        again.set_params(sigma=1)
