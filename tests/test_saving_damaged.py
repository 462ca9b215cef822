"""Changed and damaged saved maps: each is refused in one line."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import Plane3dMapper, PointMapper, RelmapError
from relmap.io.saving import checksum
from tests.savedmaps import saved_map, told
from tests.worlds import fed


def rewritten(path: Path, change: Any, *, honest: bool = False) -> None:
    """Change columns and header of a saved map; if honest, the checksum stays as it was."""
    with np.load(path) as content:
        arrays = dict(content)
    header = json.loads(arrays["header"].tobytes())
    change(arrays, header)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    if not honest:
        del arrays["checksum"]
        arrays["checksum"] = checksum(arrays)
    np.savez(path, **arrays)


def shifted(name: str, by: float = 1.0) -> Any:
    def change(arrays: Any, header: Any) -> None:
        arrays[name] = arrays[name] + np.asarray(by, arrays[name].dtype)

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(
            shifted(n)
            for n in ("landmarks/position", "observations/columns/landmark", "schedule/in_view")
        ),
        lambda a, h: h["values"].update({"association/first_scan": 1}),
        lambda a, h: h["configuration"].update(group_after=9),
        lambda a, h: a.update({"landmarks/position": a["landmarks/position"].T.copy().T}),
        lambda a, h: a.update(checksum=a["checksum"][:4]),
    ],
)
def test_a_changed_file_is_reported(tmp_path: Path, change: Any) -> None:
    path = saved_map(tmp_path)
    rewritten(path, change, honest=True)
    with pytest.raises(
        RelmapError, match="is damaged or not a saved map: its checksum does not match"
    ):
        PointMapper.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, h: h.update(format=4), "is of format 4, .* reads 3; map its log again"),
        (lambda a, h: h.update(format=1), "is of format 1, .* reads 3; map its log again"),
        (lambda a, h: a.pop("landmarks/weight"), "another version .*weight is missing; map its"),
        (lambda a, h: a.update(more=a["landmarks/weight"]), "more is unknown; map its log again"),
        (
            lambda a, h: h["values"].pop("association/first_scan"),
            "first_scan is missing; map its log",
        ),
        (
            lambda a, h: h["values"].update({"association/first_scan": 1.5}),
            "association/first_scan is 1.5, not int",
        ),
        (
            lambda a, h: h["values"].update({"association/first_scan": None}),
            "association/first_scan is None, not int",
        ),
        (
            lambda a, h: h["values"].update({"association/registration/alone": [0.5]}),
            "is not a list of int",
        ),
        (
            lambda a, h: a.update({"landmarks/weight": a["landmarks/weight"].astype(np.float32)}),
            "landmarks/weight is not of float64",
        ),
        (
            lambda a, h: a.update({"landmarks/weight": a["landmarks/weight"][:, None]}),
            r"weight has shape \(\d+, 1\), and not 1 dimensions",
        ),
        (
            lambda a, h: a.update({"landmarks/weight": a["landmarks/weight"][:-1]}),
            "columns of the landmarks are of different lengths",
        ),
        (shifted("groups/mapped/landmarks_rows"), "groups/mapped/landmarks has .* rows, and not"),
        (lambda a, h: h.update(values=[]), "is damaged or not a saved map"),
        (lambda a, h: h.update(configuration={"group_after": "x"}), "group_after"),
        (lambda a, h: h.clear(), "format"),
    ],
)
def test_a_file_that_was_made_up(tmp_path: Path, change: Any, message: str) -> None:
    path = saved_map(tmp_path)
    rewritten(path, change)
    with pytest.raises(RelmapError, match=message) as caught:
        PointMapper.load(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = saved_map(tmp_path)
    data = path.read_bytes()
    size = len(data)
    for length in (0, 1, 100, *range(size // 9, size, size // 9), size - 22, size - 1):
        path.write_bytes(data[:length])
        with pytest.raises(RelmapError) as caught:
            PointMapper.load(path)
        said = str(caught.value)
        assert said.startswith(f"saved map {path} is damaged or not a saved map: "), length
        assert "\n" not in said


def test_bombs_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "mapper.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", bytes(10**7))
    with pytest.raises(RelmapError, match="not part of a saved map"):
        PointMapper.load(tmp_path / "mapper.npz")


def test_flipped_bytes_anywhere_give_one_line_or_the_same_map(tmp_path: Path) -> None:
    """Above all in the zip headers of members, where a flip may go unnoticed."""
    path = saved_map(tmp_path)
    data, rng = path.read_bytes(), np.random.default_rng(1)
    whole = told(PointMapper.load(path))
    with zipfile.ZipFile(path) as archive:
        heads = [member.header_offset for member in archive.infolist()]
        directory = archive.start_dir
    at = [
        *rng.integers(len(data), size=150),
        *(np.repeat(rng.choice(heads, 30), 5) + rng.integers(200, size=150)),
        *rng.integers(directory, len(data), size=200),
    ]
    n_told = 0
    for k in at:
        broken = bytearray(data)
        broken[k] ^= 1 << int(rng.integers(8))
        path.write_bytes(broken)
        try:
            assert told(PointMapper.load(path)) == whole
        except RelmapError as error:
            n_told += 1
            said = str(error)
            assert "\n" not in said
            assert str(path) in said
    assert n_told > 250


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (shifted("submaps/0/match_rows", 1), "submaps/0/match has .* rows, and not"),
        (shifted("submaps/0/poses/0_rows", -1), "submaps/0/poses/0 has .* rows, and not"),
        (lambda a, h: a.pop("submaps/0/seen/cell_m"), "another version .*cell_m is missing"),
        (lambda a, h: a.update({"submaps/0/seen/cell_m": np.ones(2)}), "is damaged or not"),
        (lambda a, h: a.update({"submaps/0/sights/number": np.arange(9)}), "is damaged or not"),
        (lambda a, h: h["values"].update({"submaps/0/held": [0.5]}), "held is not a list of int"),
        (lambda a, h: h["values"].update(submaps=2), "submaps/1/iteration is missing"),
        (lambda a, h: h["configuration"].update(most=0), "they must be at least 10 and 1"),
        (lambda a, h: h["configuration"].update(size=3), "are not settings of planes3d"),
    ],
)
def test_a_file_of_planes_in_space_that_was_made_up(
    tmp_path: Path, change: Any, message: str
) -> None:
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 3.0, 60)] * 2))
    corner = np.concatenate([np.insert(np.column_stack([u, v]), k, 0.0, axis=1) for k in range(3)])
    mapper = fed(Plane3dMapper(), (corner - [x, 1.0, 1.0] for x in (1.0, 1.1, 1.2)))
    mapper.save(tmp_path / "mapper.npz")
    rewritten(tmp_path / "mapper.npz", change)
    with pytest.raises(RelmapError, match=message) as caught:
        Plane3dMapper.load(tmp_path / "mapper.npz")
    assert "\n" not in str(caught.value)
