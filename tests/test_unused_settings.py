"""Options and settings that a run would ignore are refused, and none is reported as used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap import MapperConfig, PlaneMapper, PointMapper, RelmapError
from relmap.cli import main
from relmap.simulation import building_scene
from tests.commands import load

pytestmark = pytest.mark.usefixtures("unrendered")

COMMON: dict[str, object] = {
    "group_after": 10,
    "second_pass": 3,
    "third_pass": 6,
    "max_missed": 5,
    "refine_live": True,
}
USED: dict[str, dict[str, object]] = {
    "constellation": COMMON | {"registration": "constellation", "keep_observations": False},
    "nearest-previous": COMMON
    | {"registration": "nearest-previous", "gate_m": None, "keep_observations": False},
    "known": COMMON | {"keep_observations": False},
    "planes": COMMON | {"bridge_m": 1.0},
}
RUNS = {
    "constellation": ["log.csv"],
    "nearest-previous": ["log.csv", "--registration", "nearest-previous"],
    "known": ["log.csv", "--association", "known"],
    "planes": ["scans.npz", "--variant", "planes"],
}
SETTINGS: dict[str, object] = {
    "group_after": 7,
    "second_pass": 2,
    "third_pass": 9,
    "max_missed": 3,
    "registration": "constellation",
    "gate_m": 0.5,
    "keep_observations": True,
    "refine_live": False,
    "bridge_m": 0.5,
}
OPTIONS = {
    "--association nearest": RUNS.keys(),
    "--association known": {"constellation", "known"},
    "--registration constellation": {"constellation", "nearest-previous"},
    "--registration nearest-previous": {"constellation", "nearest-previous"},
    "--no-refine": RUNS.keys(),
    "--scans 0:3": RUNS.keys(),
    "--format observation-csv": RUNS.keys() - {"planes"},
    "--format scans-npz": {"planes"},
    "--journal run.journal": RUNS.keys(),
    "--onto old": {"constellation"},
    "--onto old --journal run.journal": set(),
    "--onto old --animate": set(),
    "--onto old --registration constellation": set(),
    "--onto old --association known": set(),
    "--onto old --config settings.toml": set(),
    "--animate": {"planes"},
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(0)
    places = rng.uniform(-5, 5, (8, 2))
    rows = [f"{k},{x - 0.1 * k},{y},{i}" for k in range(20) for i, (x, y) in enumerate(places)]
    (folder / "log.csv").write_text("iteration,x,y,id\n" + "\n".join(rows) + "\n")
    points = building_scene(points=300, seed=0).points
    counts = np.repeat(np.arange(4), len(points))
    stamps_s = np.arange(4.0)
    scans = np.tile(points, (4, 1))
    np.savez(folder / "scans.npz", points=scans, iteration=counts, stamps_s=stamps_s)
    assert main(["map", str(folder / "log.csv"), "-o", str(folder / "old")]) == 0
    (folder / "settings.toml").write_text("group_after = 7\n")
    return folder


@pytest.fixture
def mapped(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, str], int]:
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    # No frame of an animation is drawn: it takes seconds.
    monkeypatch.setattr("relmap.plots.bench.write_bench_gif", lambda *_: None)
    return lambda run, options: main(["map", *RUNS[run], "-o", "out", *options.split()])


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("option", OPTIONS)
def test_options(
    mapped: Callable[[str, str], int], capsys: pytest.CaptureFixture[str], run: str, option: str
) -> None:
    code = mapped(run, option)
    if run in OPTIONS[option]:
        assert code == 0
    else:
        assert code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("relmap: error: ")
        assert not Path("out").exists()
        assert not Path("run.journal").exists()


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("key", SETTINGS)
def test_settings_of_a_file(
    mapped: Callable[[str, str], int], capsys: pytest.CaptureFixture[str], run: str, key: str
) -> None:
    value = SETTINGS[key]
    text = f'"{value}"' if isinstance(value, str) else str(value).lower()
    Path("own.toml").write_text(f"{key} = {text}\n")
    code = mapped(run, "--config own.toml")
    if key in USED[run]:
        assert code == 0
        told = load(Path("out") / "summary.json")["configuration"]
        expected = USED[run] | {key: value}
        if run == "nearest-previous":
            expected["registration"] = run  # the option goes before the file
        assert told == expected
    else:
        assert code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "own.toml" in line
        assert key in line
        assert not Path("out").exists()


@pytest.mark.parametrize("run", RUNS)
def test_the_summary_lists_settings_in_use(mapped: Callable[[str, str], int], run: str) -> None:
    assert mapped(run, "") == 0
    assert load(Path("out") / "summary.json")["configuration"] == USED[run]


@pytest.mark.parametrize(
    "settings",
    [{"registration": "nearest-previous"}, {"registration": "nearest-previous", "gate_m": 1.0}],
)
def test_registration_with_ids_in_python(settings: dict[str, object]) -> None:
    mapper = PointMapper(MapperConfig.from_mapping(settings))
    with pytest.raises(RelmapError, match="registration would be ignored"):
        mapper.update(np.eye(3), ids=[1, 2, 3])
    assert mapper.update(np.eye(3)).tolist() == [0, 1, 2]  # it is as it was
    assert mapper.settings["registration"] == "nearest-previous"


@pytest.mark.parametrize(
    "settings",
    [
        {"registration": "nearest-previous"},
        {"registration": "nearest-previous", "gate_m": 1.0},
        {"keep_observations": True},
    ],
)
def test_settings_of_points_for_walls_in_python(settings: dict[str, object]) -> None:
    config = MapperConfig.from_mapping(settings)
    with pytest.raises(RelmapError, match="would be ignored: walls"):
        PlaneMapper(config)


def test_a_gate_without_its_registration_in_python() -> None:
    with pytest.raises(RelmapError, match="gate_m is only for registration nearest-previous"):
        MapperConfig(gate_m=0.5)


def test_a_resumed_run_lists_the_same_settings(mapped: Callable[[str, str], int]) -> None:
    assert mapped("known", "--journal run.journal") == 0
    assert main(["resume", "run.journal", "-o", "again"]) == 0
    assert load(Path("again") / "summary.json")["configuration"] == USED["known"]
