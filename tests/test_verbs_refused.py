"""Common mistakes with each verb: one line with advice, and exit code 2."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from relmap.cli import main
from tests.everyformat import Mapped

pytestmark = pytest.mark.usefixtures("unrendered")

VERBS = [
    (["map", "{}", "-o", "out"], ["csv", "csv/observations.csv"]),
    (["map", "{}", "-o", "out", "--variant", "planes"], ["npz"]),
    (["map", "csv", "-o", "out", "--onto", "{}"], ["of-points"]),
    (["localise", "{}", "--map", "of-points", "-o", "out"], ["csv", "csv/observations.csv"]),
    (["localise", "csv", "--map", "{}", "-o", "out"], ["of-points", "of-walls"]),
    (["evaluate", "{}", "--truth", "csv"], ["of-points", "of-walls"]),
    (["evaluate", "of-points", "--truth", "{}"], ["csv", "csv/truth"]),
    (["evaluate", "of-points", "--truth", "csv", "--log", "{}"], ["csv", "csv/observations.csv"]),
    (["evaluate", "of-walls", "--truth", "{}"], ["npz", "npz/truth"]),
    (["compare", "{}", "-o", "out"], ["csv", "csv/observations.csv", "npz"]),
    (["compare", "csv", "-o", "out", "--truth", "{}"], ["csv", "csv/truth"]),
    (["compare", "npz", "-o", "out", "--truth", "{}"], ["npz", "npz/truth"]),
    (["merge", "{}", "of-points", "-o", "out"], ["of-points"]),
    (["merge", "of-walls", "{}", "-o", "out"], ["of-walls"]),
    (["export", "{}", "--to", "dxf", "-o", "out"], ["of-points", "of-walls"]),
    (["export", "of-walls", "--to", "grid", "-o", "out", "--log", "{}"], ["npz"]),
    (["resume", "{}"], []),
    (["sweep", "{}", "-o", "out"], []),
    (["figures", "17", "-o", "out", "--data", "{}"], []),
]
KINDS = ["csv", "npz", "of-points", "of-walls", "csv/truth", "npz/truth", "csv/observations.csv"]
KINDS += ["empty", "gone", "pictures", "pictures/map.png"]


@pytest.fixture(scope="session")
def wrong(logs: Path, mapped: Mapped) -> Path:
    """Return a folder with typical wrong inputs."""
    (logs / "empty").mkdir()
    (logs / "pictures").mkdir()
    shutil.copytree(mapped("csv/observations.csv"), logs / "of-points")
    shutil.copytree(mapped("npz"), logs / "of-walls")
    shutil.copy(logs / "of-walls" / "map.png", logs / "pictures")
    return logs


@pytest.mark.parametrize(("command", "right"), VERBS, ids=lambda value: " ".join(value[:3]))
def test_a_wrong_kind_of_input_is_refused_in_one_line(
    wrong: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: list[str],
    right: list[str],
) -> None:
    monkeypatch.chdir(wrong)
    for kind in KINDS:
        if kind in right:
            continue
        assert main([word.format(kind) for word in command]) == 2, kind
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("relmap: error: ")
        assert kind in printed.err
        assert printed.err.count("\n") == 1
        assert not (wrong / "out").exists()


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("evaluate of-walls --truth npz --log npz", "--log is for a map of points"),
        ("evaluate of-walls --truth csv", "csv: contains no truth/planes.csv"),
        ("evaluate of-walls --truth of-walls", "is a result folder without truth"),
        ("compare npz --truth of-walls -o out", "is a result folder without truth"),
        ("compare empty -o out", "neither a landmark log nor a log of point scans"),
        ("compare csv --format cassette -o out", "observation-csv, mrpt-landmarks"),
        ("compare csv --format cassette -o out", "scans-npz, carmen-log"),
        ("compare carmen/a.log.gz --format mrpt-laser2d -o out", "a.log.gz"),
        ("localise csv --map empty -o out", "expected one that 'relmap map' wrote"),
        ("localise csv --map of-walls -o out", "is a landmark log"),
        (
            "map npz --variant planes --onto of-points -o out",
            "holds a map of points, not a map of walls",
        ),
    ],
)
def test_errors_say_what_is_expected(
    wrong: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    said: str,
) -> None:
    monkeypatch.chdir(wrong)
    assert main(command.split()) == 2
    assert said in capsys.readouterr().err


def test_walls_whose_corners_are_missing_are_not_merged(
    mapped: Mapped, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(mapped("npz"), tmp_path / "cut")
    path = tmp_path / "cut" / "landmarks.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    asked = ["merge", str(mapped("npz")), str(tmp_path / "cut"), "-o", str(tmp_path / "out")]
    assert main(asked) == 2
    assert "landmarks.csv beside it lacks" in capsys.readouterr().err
