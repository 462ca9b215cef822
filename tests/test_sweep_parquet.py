"""``relmap sweep``: the table in Parquet, beside that in CSV."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from relmap.cli import main
from relmap.comparison.methods.running import ACCURACY
from relmap.comparison.sweep import TIMES, Finished, accuracy_csv, write_parquet
from relmap.comparison.sweep_spec import cells_of
from relmap.core.errors import RelmapError
from relmap.io.files import atomic_write
from tests.commands import names, table

FIGURES: dict[str, float | None] = dict.fromkeys((*ACCURACY, *TIMES), 1.0)


def test_parquet_holds_the_same_table(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="no pyarrow: relmap[parquet]")
    cells = cells_of({"method": ["ekf", "batch"], "sigma": [0.1, 0.2]})
    done = [Finished(FIGURES | {"ate_m": 0.1 * k, "corner_rmse_m": None}) for k in range(4)]
    write_parquet(tmp_path / "sweep.parquet", cells, done)
    (tmp_path / "sweep.csv").write_text(accuracy_csv(cells, done))
    columns = parquet.read_table(tmp_path / "sweep.parquet").to_pydict()
    rows = table(tmp_path / "sweep.csv")
    assert list(columns) == list(rows[0])
    assert columns["ate_m"] == [float(row["ate_m"]) for row in rows]
    assert columns["corner_rmse_m"] == [None] * 4
    assert columns["method"] == [row["method"] for row in rows]


@pytest.fixture
def swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with old tables, beside a sweep of one cell."""
    pytest.importorskip("pyarrow.parquet", reason="no pyarrow: relmap[parquet]")
    monkeypatch.chdir(tmp_path)
    Path("one.toml").write_text('method = ["relmap-points"]\niterations = [20]\n')
    Path("out").mkdir()
    for name in ("sweep.csv", "sweep.parquet"):
        Path("out", name).write_text("old")
    return tmp_path / "out"


def test_without_pyarrow_no_old_parquet_is_left(
    swept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["sweep", "one.toml", "-o", "out", "--workers", "1"]) == 0
    assert "no sweep.parquet: pyarrow is not installed" in capsys.readouterr().err
    assert names(swept) == ["cells", "sweep.csv", "sweep.png", "timing.csv"]


def test_a_parquet_that_cannot_be_written_is_an_error(
    swept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, content: str) -> None:
        if path.suffix == ".parquet":
            raise RelmapError(f"cannot write {path}: No space left on device")
        atomic_write(path, content)

    monkeypatch.setattr("relmap.comparison.sweep.atomic_write", full)
    assert main(["sweep", "one.toml", "-o", "out", "--workers", "1"]) == 2
    said = "relmap: error: cannot write out/sweep.parquet: No space left on device\n"
    assert capsys.readouterr().err.endswith(said)
    assert {(swept / name).read_text() for name in ("sweep.csv", "sweep.parquet")} == {"old"}
