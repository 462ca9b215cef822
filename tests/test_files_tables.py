"""Tables keep text, gaps and every bit of a number, and name the cell that is wrong."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap import RelmapError
from relmap.datasets.own_table import MAX_NAME
from relmap.io.results import read_names, write_names
from relmap.io.tables import Kind, compressed, csv_text, read_columns

COLUMNS: dict[str, Kind] = {"n": "int", "x": "float", "sd": "float or empty", "word": "text"}


@given(st.lists(st.floats(-1e9, 1e9) | st.just(math.nan), max_size=5))
def test_floats_come_back_bit_by_bit(
    tmp_path_factory: pytest.TempPathFactory, values: list[float]
) -> None:
    path = tmp_path_factory.getbasetemp() / "table.csv.gz"
    path.write_bytes(compressed(csv_text(["sd", "n"], ((v, 1) for v in values))))
    again = read_columns(path, {"sd": "float or empty"})["sd"]
    np.testing.assert_array_equal(again, np.array(values, dtype=np.float64))


def test_compression_depends_on_the_text_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    now = compressed("text")
    monkeypatch.setattr(time, "time", lambda: 1e9)
    assert compressed("text") == now


def test_columns_are_found_in_any_order_among_others(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("word, x ,more,sd,n\r\n\r\nfar,0.5,?,,7\r\n")
    table = read_columns(path, COLUMNS)
    assert table["n"].tolist() == [7]
    assert table["n"].dtype == np.int64
    assert table["x"].tolist() == [0.5]
    assert np.isnan(table["sd"]).tolist() == [True]
    assert table["word"].tolist() == ["far"]


def test_header_alone_is_an_empty_table(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("n,x,sd,word\n")
    assert [len(column) for column in read_columns(path, COLUMNS).values()] == [0] * 4


def test_names_of_any_length_that_a_log_may_have_come_back(tmp_path: Path) -> None:
    names = {0: "a" * MAX_NAME, 3: 'b, "c"\nd'}
    write_names(tmp_path, names)
    assert read_names(tmp_path) == names
    write_names(tmp_path, {0: "a" * (MAX_NAME + 1)})
    with pytest.raises(RelmapError, match="not a name of at most 200 characters"):
        read_names(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty, expected the header n,x,sd,word"),
        ("n,x,word\n", "line 1: no column sd"),
        ("n,x,sd,word\n1,2,3\n", "line 2: 3 fields, expected 4"),
        ("n,x,sd,word\n1,2,3,a\n\n1.5,2,3,a\n", "line 4, field n: '1.5' is not a whole"),
        ("n,x,sd,word\n99999999999999999999,2,3,a\n", "line 2, field n"),
        ("n,x,sd,word\n1,,3,a\n", "line 2, field x: '' is not a number"),
        ("n,x,sd,word\n1,inf,3,a\n", "line 2, field x: 'inf' is not a number"),
        ("n,x,sd,word\n1,1e10,3,a\n", "line 2, field x: '1e10' is not a number"),
        ("n,x,sd,word\n1,2,nan,a\n", "line 2, field sd: 'nan' is not a number"),
    ],
)
def test_bad_table_is_named_by_line_and_field(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(RelmapError, match=message):
        read_columns(path, COLUMNS)
