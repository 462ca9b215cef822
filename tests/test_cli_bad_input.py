"""Bad input: exit code 2, one line on stderr, and an unchanged earlier result."""

from __future__ import annotations

import errno
import gzip
import os
import resource
from pathlib import Path

import pytest

from relmap.cli import main
from tests.commands import GOOD, RELMAP, Check, run_process, shown, snapshot

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"iteration,x,y,z\n1,2,3,4\n1,inf,3,4\n", "line 3, field x"),
        (b"iteration,x,y,z\n0,2,3,4\n99999999,2,3,4\n", "iteration"),
        (gzip.compress(GOOD.encode(), mtime=0)[:-20], "gzip"),
        (bytes(range(256)) * 40, "log.bad"),
    ],
    ids=shown,
)
def test_bad_log(place: Path, refused: Check, content: bytes, message: str) -> None:
    (place / "log.bad").write_bytes(content)
    assert message in refused("map", "log.bad", "-o", "out")
    refused("map", "log.bad", "-o", "new/folder")
    refused("evaluate", "out", "--truth", "truth", "--log", "log.bad")


def test_no_log(place: Path, refused: Check) -> None:
    (place / "empty").mkdir()
    assert "does not exist" in refused("map", "none.csv", "-o", "out")
    assert "holds no landmark log" in refused("map", "empty", "-o", "out")
    assert "'INPUT': it is empty" in refused("map", "", "-o", "out")
    assert "not known" in refused("map", "log.csv", "-o", "out", "--format", "cassette")
    assert "does not exist" in refused("evaluate", "out", "--truth", "truth", "--log", "none")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mapp"], "No such command 'mapp'"),
        (["--loud"], "No such option: --loud"),
        (["map"], "Missing argument 'INPUT'"),
        (["map", "log.csv"], "Missing option '--out'"),
        (["map", "log.csv", "-o"], "requires an argument"),
        (["map", "log.csv", "-o", ""], "empty"),
        (["map", "log.csv", "extra", "-o", "out"], "unexpected extra argument"),
        (["map", "log.csv", "-o", "out", "--fast"], "No such option: --fast"),
        (["map", "log.csv", "-o", "out", "--association", "guess"], "'nearest', 'known'"),
        (["map", "log.csv", "-o", "out", "--association", "known"], "needs ids"),
        (["map", "log.csv", "-o", "out", "--variant", "planes"], "point scans"),
        (["map", "log.csv", "-o", "out", "--variant", "lines"], "'points', 'planes'"),
        (["map", "log.csv", "-o", "out", "--config", "none.toml"], "does not exist"),
        (["map", "log.csv", "-o", "out", "--config", "truth"], "is a folder"),
        (
            ["map", "log.csv", "-o", "out", "--range-sigma", "-1", "--bearing-sigma", "1"],
            "--range-sigma is -1.0",
        ),
        (["simulate"], "Missing command"),
        (["simulate", "figure-nine", "-o", "new"], "No such command"),
        (["simulate", "figure-eight"], "Missing option '--out'"),
        (["simulate", "figure-eight", "-o", "new", "--density", "0"], "density"),
        (["simulate", "figure-eight", "-o", "new", "--density", "many"], "--density"),
        (["simulate", "figure-eight", "-o", "new", "--iterations", "0"], "iterations"),
        (["simulate", "figure-eight", "-o", "new", "--iterations", "1.5"], "--iterations"),
        (["simulate", "figure-eight", "-o", "new", "--noise", "pink"], "'gaussian', 'uniform'"),
        (["simulate", "figure-eight", "-o", "new", "--sigma", "nan"], "sigma"),
        (["simulate", "figure-eight", "-o", "new", "--sigma", "-1"], "sigma"),
        (["simulate", "figure-eight", "-o", "new", "--dynamic", "1.5"], "dynamic"),
        (["simulate", "figure-eight", "-o", "new", "--seed", "-1"], "seed"),
        (["evaluate", "out"], "Missing option '--truth'"),
        (["evaluate", "truth", "--truth", "truth"], "not a result folder"),
        (["evaluate", "none", "--truth", "truth"], "not a result folder"),
        (["demo", "--seed", "one"], "--seed"),
        (["demo", "--seed", "-1", "-o", "new"], "seed"),
        (["demo", "extra"], "unexpected extra argument"),
        (["map", "no\nsuch\x1bfile", "-o", "out"], "does not exist"),
        (["--no\nsuch"], "No such option"),
    ],
)
def test_bad_command(refused: Check, arguments: list[str], message: str) -> None:
    assert message in refused(*arguments)


def test_a_result_that_is_only_read_is_not_overwritten(place: Path, refused: Check) -> None:
    (place / "link").symlink_to("out")
    for out in ("out", "truth/../out", "link"):
        assert "give another folder" in refused("localise", "log.csv", "--map", "out", "-o", out)
        assert "give another folder" in refused("merge", "out", "truth", "-o", out)
        assert "give another folder" in refused("merge", "truth", "out", "-o", out)
    (place / "other").mkdir()
    (place / "other" / "summary.json").write_text("{}")
    assert "would be overwritten" in refused("localise", "log.csv", "--map", "out", "-o", "other")


@pytest.mark.parametrize("name", ["landmarks.csv", "bench.gif", "submap-3.tum", "submap-3.csv"])
def test_a_journal_among_the_results_has_another_name(refused: Check, name: str) -> None:
    said = refused("map", "log.csv", "-o", "new", "--journal", f"truth/../new/{name}")
    assert "give it another name" in said


@pytest.mark.parametrize(
    "scans",
    ["", "5", "5:", ":5", "a:b", "5:5", "6:5", "-1:5", "1:2:3", "\u0663:\u0665", " 1:2", "50:60"],
)
def test_bad_scans(refused: Check, scans: str) -> None:
    assert "scans" in refused("map", "log.csv", "-o", "out", f"--scans={scans}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("group_affer = 3\n", "group_affer"),
        ("[mapper]\ngroup_after = 3\n", "mapper"),
        ("group_after = -3\n", "group_after"),
        ('group_after = "many"\n', "group_after"),
        ("group_after = nan\n", "group_after"),
        ("group_after 3\n", "not TOML"),
        (f"group_after = 0x{'f' * 9000}\n", "thousands of digits"),
        ("\0", "mapper.toml"),
    ],
)
def test_bad_configuration(place: Path, refused: Check, text: str, message: str) -> None:
    (place / "mapper.toml").write_text(text)
    line = refused("map", "log.csv", "-o", "out", "--config", "mapper.toml")
    assert message in line
    assert "mapper.toml" in line


@pytest.mark.parametrize(("name", "said"), [("g", "g"), ("a\nb", r"'a\nb'")])
@pytest.mark.parametrize("text", ["group_after = -3\n", "group_after 3\n"])
def test_bad_configuration_whatever_the_name(
    place: Path, refused: Check, name: str, said: str, text: str
) -> None:
    """A name of one letter, which the message has anyway, and one with a line break."""
    (place / name).write_text(text)
    line = refused("map", "log.csv", "-o", "out", "--config", name)
    assert f"error: {said}: " in line
    assert line.count("a\\nb") == said.count("a\\nb")


@pytest.mark.parametrize("out", ["log.csv", "log.csv/below", "/proc/no", "/dev/null", "x" * 300])
def test_folder_that_cannot_be_written(refused: Check, out: str) -> None:
    assert "cannot write into" in refused("map", "log.csv", "-o", out)
    assert "cannot write into" in refused("simulate", "figure-eight", "-o", out)
    assert "cannot write into" in refused("demo", "-o", out)


def test_folder_in_the_place_of_a_file(place: Path, refused: Check) -> None:
    for name in ("new/landmarks.csv", "out/sub"):
        (place / name).mkdir(parents=True)
    assert "new/landmarks.csv" in refused("map", "log.csv", "-o", "new")
    (place / "out" / "evaluation.json").unlink()
    (place / "out" / "evaluation.json").mkdir()
    assert "cannot write" in refused("evaluate", "out", "--truth", "truth")


def test_full_disk(refused: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert "out/map.png: No space left" in refused("map", "log.csv", "-o", "out")
    assert "No space left" in refused("evaluate", "out", "--truth", "truth")
    options = ["--iterations", "5", "--density", "4"]
    assert "No space left" in refused("simulate", "figure-eight", "-o", "new/one", *options)


def test_not_enough_memory(refused: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("relmap.cli.mapping.run_mapper", exhausted)
    assert "not enough memory" in refused("map", "log.csv", "-o", "out")


def test_a_bug_shows_its_traceback(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    before = snapshot(place)
    monkeypatch.setattr("relmap.cli.mapping.run_mapper", bug)
    with pytest.raises(ZeroDivisionError):
        main(["map", "log.csv", "-o", "out"])
    assert snapshot(place) == before


def run(
    arguments: list[str], folder: Path, env: dict[str, str], most_bytes: int | None = None
) -> tuple[int, str]:
    """Run the command line in a separate process, perhaps with a limit to its files' sizes."""

    def limit() -> None:
        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    done = run_process(
        [*RELMAP, *arguments],
        cwd=folder,
        env=env | {"PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=limit,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("arguments", "most_bytes"),
    [
        (["map", "log.csv", "-o", "out", "--loud"], None),
        (["map", "log.csv", "-o", "out"], 3000),
    ],
)
def test_from_a_shell(
    place: Path, child_env: dict[str, str], arguments: list[str], most_bytes: int | None
) -> None:
    before = snapshot(place)
    code, errors = run(arguments, place, child_env, most_bytes)
    assert code == 2
    assert errors.startswith("relmap: error: ")
    assert errors.count("\n") == 1
    assert snapshot(place) == before
