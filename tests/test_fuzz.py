"""Hostile files: refused by a RelmapError of one line, or soundly read; see `tests.fuzz`."""

from __future__ import annotations

import io
import json
import logging
import lzma
import struct
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from relmap.core.errors import RelmapError
from relmap.datasets import matfile, open_scans, point_clouds, scans_npz, table, textfile
from relmap.datasets.matfile import read_matrix
from relmap.io.tables import read_columns
from tests.damage import made_to_harm, packed_rows
from tests.fuzz import ACCEPTED, REFUSED, fuzz, outcome
from tests.fuzz import put as put_all
from tests.hostile import mat, readers, scans
from tests.logs import failure, put
from tests.scanlogs import CLOUD, CORRECTED, pcd

READERS = readers()
GROUPS = [list(READERS)[k::8] for k in range(8)]
"""Readers of all kinds in each: of some formats nearly every damaged file is refused."""
SOME = 60
"""Damaged files for each reader; `python -m tests.fuzz` takes 200 000."""


@pytest.fixture
def quiet() -> Iterator[None]:
    """Let warnings of numpy pass: they are not tracebacks, and the command line turns them off."""
    logging.disable()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("names", GROUPS)
def test_damaged_files_are_soundly_read_or_refused(
    names: list[str], tmp_path: Path, quiet: None
) -> None:
    counts = Counter[str]()
    for name in names:
        reader, folder = READERS[name], tmp_path / name.replace("/", "-")
        folder.mkdir()
        put_all(folder, reader.files)
        assert outcome(reader, folder) == ACCEPTED, f"{name}, not damaged"
        found, problems = fuzz(reader, folder, SOME, float("inf"), seed=7)
        assert not problems, name
        assert found[REFUSED] > 0, name
        counts += found
    assert counts[REFUSED] + counts[ACCEPTED] == SOME * len(names)
    assert 0 < counts[REFUSED] < SOME * len(names)


@pytest.mark.parametrize("name", [name for name in READERS if not name.startswith("result")])
@settings(max_examples=15)
@given(data=st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(name: str, folder: Path, data: bytes) -> None:
    reader = READERS[name]
    put_all(folder, reader.files | {reader.damaged: data})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert outcome(reader, folder) in (REFUSED, ACCEPTED)


def test_files_made_to_harm_are_refused(tmp_path: Path, quiet: None) -> None:
    for name, files in made_to_harm(tmp_path / "canary").items():
        reader, folder = READERS[name], tmp_path / name.replace("/", "-")
        folder.mkdir()
        for kind, data in files.items():
            put_all(folder, reader.files | {reader.damaged: data})
            assert outcome(reader, folder) == REFUSED, (name, kind)
    assert not (tmp_path / "canary").exists()


def test_a_format_that_is_not_a_text_is_ignored(tmp_path: Path, quiet: None) -> None:
    reader = READERS["result-summary.json"]
    put_all(tmp_path, reader.files)
    summary = json.loads(reader.files[reader.damaged])
    whole = reader.read(tmp_path)
    put_all(tmp_path, {reader.damaged: json.dumps(summary | {"format": [1]}).encode()})
    assert reader.read(tmp_path) == whole


def test_paths_in_archives_are_not_followed(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(scans())) as old, zipfile.ZipFile(stream, "w") as new:
        for name in old.namelist():
            new.writestr(f"../{name}", old.read(name))
    inner = tmp_path / "inner"
    inner.mkdir()
    path = put(inner, stream.getvalue(), "scans.npz")
    with pytest.raises(RelmapError, match=r"points\.npy"):
        open_scans(path)
    assert sorted(tmp_path.rglob("*")) == [inner, path]


def test_archive_of_other_files_is_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for k in range(2000):
            archive.writestr(f"{k}", b"")
    path = put(tmp_path, stream.getvalue(), "scans.npz")
    with pytest.raises(RelmapError, match=r"is a zip archive, not a log of point scans"):
        open_scans(path)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999, 2)}",
        "{'descr': '(2,f4', 'fortran_order': False, 'shape': (2, 2)}",
        "{'descr': '<f4',\n  'fortran_order': False, 'shape': (2, 2)}\n 1",
    ],
)
def test_headers_that_are_not_of_arrays_are_refused(tmp_path: Path, header: str) -> None:
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + b"\0" * 16
    with zipfile.ZipFile(tmp_path / "scans.npz", "w") as archive:
        for name in ("points", "iteration", "stamps_s"):
            archive.writestr(f"{name}.npy", array)
    with pytest.raises(RelmapError, match=r"scans\.npz"):
        open_scans(tmp_path / "scans.npz")


def test_arrays_are_packed_as_numpy_packs_them(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "scans.npz", "w", zipfile.ZIP_LZMA) as archive:
        for name in ("points", "iteration", "stamps_s"):
            archive.writestr(f"{name}.npy", b"\0" * 200)
    with pytest.raises(RelmapError, match="packed in a way that numpy does not use"):
        open_scans(tmp_path / "scans.npz")


def test_bombs_are_refused_by_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(textfile, "MAX_LINES", 1000)
    rows = packed_rows(b"iteration,x,y\n", b"0,0,0\n", 1 << 20)
    assert "more than 1000 lines" in failure(put(tmp_path, rows, "a.csv"))
    monkeypatch.setattr(textfile, "MAX_LINES", 1 << 30)
    monkeypatch.setattr(table, "MAX_NUMBERS", 1000)
    assert "more than 1000 numbers" in failure(tmp_path / "a.csv")
    monkeypatch.setattr(point_clouds, "MAX_BYTES", 100_000)
    cloud = put(tmp_path, lzma.compress(pcd(CLOUD) + bytes(1 << 20)), "0.pcd.xz")
    with pytest.raises(RelmapError, match="more than 100000 bytes"):
        list(open_scans(cloud).scans())
    monkeypatch.setattr(matfile, "MAX_BYTES", 10_000)
    with pytest.raises(RelmapError, match="more than 10000 bytes when unpacked"):
        read_matrix(put(tmp_path, mat(a=np.zeros((500, 500))), "a.mat"), "a")
    monkeypatch.setattr(scans_npz, "MAX_BYTES", 100)
    with pytest.raises(RelmapError, match="bytes when unpacked, more than 100"):
        open_scans(put(tmp_path, scans(), "scans.npz"))


def test_a_long_word_does_not_widen_its_column(tmp_path: Path) -> None:
    path = put(tmp_path, f"status\nstatic\n{'a' * 60_000}\n", "a.csv")
    with pytest.raises(RelmapError, match=r"line 3, field status: .* at most 32 characters"):
        read_columns(path, {"status": "text"})


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_matrices_are_read_as_scipy_does(tmp_path: Path, kind: str, compress: bool) -> None:
    rng = np.random.default_rng(0)
    for n, m in ((1, 1), (1, 4), (3, 2), (40, 7)):
        matrix = (100 * rng.random((n, m))).astype(kind)
        path = put(tmp_path, mat(compress, other=np.eye(3), name=matrix), "a.mat")
        np.testing.assert_array_equal(read_matrix(path, "name"), loadmat(path)["name"])


def test_unsorted_stamps_are_reported_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    later, earlier = CORRECTED.splitlines()[-1], CORRECTED.splitlines()[3]
    path = put(tmp_path, f"{later}\n{earlier}\n", "a.log")
    assert open_scans(path).stamps_s.tolist() == [4.5, 5.5]
    assert caplog.messages == [f"{path}: 1 scans out of order: all are sorted by time"]
