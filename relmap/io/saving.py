"""Saved states: the columns of a mapper's parts in an uncompressed ``.npz`` file.

The file also contains ``header``, a JSON text with all other values, and ``checksum`` over
everything.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError, reason
from relmap.datasets.scans_npz import DAMAGE, read_array
from relmap.io.files import atomic_write
from relmap.io.state import OtherColumnsError, StateReader, StateWriter

FORMAT = 3
"""Version of the file format."""


def save_state(path: Path, parts: list[Any], about: dict[str, Any]) -> None:
    """Save the state of some parts.

    `path`: the file, written atomically; the same state gives the same bytes. `parts`: see
    `relmap.io.state`. `about`: additional content, JSON serialisable. Raises `RelmapError`
    if the file cannot be written.
    """
    writer = StateWriter()
    for part in parts:
        writer.add(part)
    columns, plain = {}, {}
    for name, value in writer.columns.items():
        if isinstance(value, np.ndarray):
            columns[name] = value if value.flags.forc else np.ascontiguousarray(value)
        else:
            plain[name] = value
    header = json.dumps({"format": FORMAT, **about, "values": plain}).encode()
    arrays: dict[str, Any] = {"header": np.frombuffer(header, dtype=np.uint8), **columns}
    packed = io.BytesIO()
    np.savez(packed, checksum=checksum(arrays), **arrays)
    atomic_write(path, packed.getbuffer())


def load_state(path: Path, begin: Callable[[dict[str, Any]], list[Any]]) -> None:
    """Restore parts from a file that `save_state` wrote.

    `begin`: makes new parts from the additional content of the file. Raises `RelmapError` if the
    file is missing, damaged, or contains something else.
    """
    if not os.path.isfile(path):
        raise RelmapError(f"there is no saved map {path}, expected one that 'relmap map' wrote")
    try:
        arrays = _read_arrays(path)
        header = json.loads(arrays["header"].tobytes())
        if header["format"] != FORMAT:
            raise RelmapError(
                f"saved map {path} is of format {header['format']!r:.20}, and this relmap reads "
                f"{FORMAT}; map its log again"
            )
        if not np.array_equal(arrays.pop("checksum"), checksum(arrays)):
            raise ValueError("its checksum does not match")
        del arrays["header"]
        reader = StateReader(arrays | header["values"])
        for part in begin(header):
            reader.restore(part)
        reader.end()
    except OtherColumnsError as error:
        raise RelmapError(
            f"saved map {path} was written by another version of relmap "
            f"({header.get('versions')}): {error}; map its log again"
        ) from error
    except (*DAMAGE, AttributeError, ArithmeticError) as error:
        raise RelmapError(
            f"saved map {path} is damaged or not a saved map: {reason(error)}"
        ) from error


def checksum(arrays: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Return a checksum over names, types, shapes and values."""
    found = hashlib.blake2b(digest_size=32)
    for name, values in arrays.items():
        found.update(f"{name} {values.dtype} {values.shape} {values.flags.c_contiguous};".encode())
        flat: Any = np.ravel(values, order="K")
        found.update(flat)
    return np.frombuffer(found.digest(), dtype=np.uint8)


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file, checked to be no larger than the file."""
    arrays: dict[str, NDArray[Any]] = {}
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if sum(m.file_size for m in members if m.compress_type == zipfile.ZIP_STORED) > size:
            raise ValueError("its parts are larger than it")
        for member in members:
            name = member.filename.removesuffix(".npy")
            if member.compress_type != zipfile.ZIP_STORED or name in arrays:
                raise ValueError(f"{member.filename!r} is not part of a saved map")
            arrays[name] = read_array(archive, member)
    return arrays
