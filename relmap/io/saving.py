"""Saving and loading a mapper's whole state, without loss and without running what a file says.

The file is an ``.npz`` of numpy, not compressed: one flat array for each type of number, and
``graph``, a text in JSON (as bytes) that tells which objects there are and how they hang together.
An object is told by its class, one of relmap's own, and its attributes.  What is shared stays
shared.
"""

from __future__ import annotations

import dataclasses
import io
import json
import re
import zipfile
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError, reason

FORMAT = 1
"""Version of the file."""
PACKAGES = ("relmap.core.", "relmap.points.", "relmap.planes.")
"""Where the classes of a mapper's parts are."""
KINDS = ("float64", "int64", "int32", "uint8", "bool", "float32", "uint64", "int8", "uint32")
"""Types of numbers that a part may hold."""
_GRAPH = "graph"
_HEAD = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '(?P<dtype>[<|][bfiu]\d)', 'fortran_order': False, "
    rb"'shape': \((?P<length>\d{1,15}),\), \} *\n",
    re.DOTALL,
)
_PLAIN = (bool, int, float, str, type(None))
_WRONG = (
    *(OSError, EOFError, zipfile.BadZipFile, NotImplementedError, RecursionError, MemoryError),
    *(ValueError, TypeError, LookupError, AttributeError, ImportError, OverflowError),
)
"""What reading a damaged file raises."""


class _Writer:
    """Turns objects into nodes of a graph and flat arrays."""

    def __init__(self, left_out: tuple[str, ...]) -> None:
        self.nodes: list[Any] = []
        self._left_out = left_out
        self._numbers: dict[int, int] = {}
        self._kept: list[Any] = []
        self._parts: dict[str, list[NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}

    def value(self, value: Any) -> Any:
        """Return what stands for a value in JSON: itself, or the number of its node in a list."""
        if type(value) in _PLAIN:
            return value
        if id(value) not in self._numbers:
            self._numbers[id(value)] = len(self.nodes)
            self._kept.append(value)  # so that nothing else gets its id
            self.nodes.append(None)
            self.nodes[self._numbers[id(value)]] = self._node(value)
        return [self._numbers[id(value)]]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return one array for each type of number."""
        return {kind: np.concatenate(parts) for kind, parts in self._parts.items()}

    def _node(self, value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return self._array(value)
        if isinstance(value, dict):
            return self._dict(value)
        for kind in (list, tuple):
            if type(value) is kind:
                return {kind.__name__: [self.value(item) for item in value]}
        state = value.__getstate__() or {}
        own = {
            name: None if name in self._left_out else self.value(part)
            for name, part in state.items()
        }
        return {"class": f"{type(value).__module__}:{type(value).__qualname__}", "state": own}

    def _array(self, value: NDArray[Any] | np.generic) -> Any:
        kind = value.dtype.name
        if kind not in KINDS:
            raise TypeError(f"an array of {kind} cannot be saved")
        across = value.flags.f_contiguous and not value.flags.c_contiguous
        order: Literal["C", "F"] = "F" if across else "C"
        at = self._sizes.get(kind, 0)
        self._sizes[kind] = at + value.size
        self._parts.setdefault(kind, []).append(np.asarray(value).ravel(order=order))
        name = "array" if isinstance(value, np.ndarray) else "number"
        return {name: kind, "at": at, "shape": list(value.shape), "order": order}

    def _dict(self, value: dict[Any, Any]) -> Any:
        keys, values = list(value), list(value.values())
        if keys and {type(item) for item in (*keys, *values)} == {int}:
            return {"numbers": [self.value(np.array(part, np.int64)) for part in (keys, values)]}
        pairs = zip(keys, values, strict=True)
        return {"dict": [[self.value(key), self.value(item)] for key, item in pairs]}


class _Reader:
    """Builds the objects that nodes tell of."""

    def __init__(self, nodes: list[Any], arrays: dict[str, NDArray[Any]]) -> None:
        self._nodes = nodes
        self._arrays = arrays
        self._built: dict[int, Any] = {}
        self._begun: set[int] = set()

    def value(self, value: Any) -> Any:
        """Return what a value in JSON stands for."""
        if not isinstance(value, list):
            if type(value) not in _PLAIN:
                raise ValueError("a value is neither plain nor the number of a node")
            return value
        (number,) = value
        if number in self._built:
            return self._built[number]
        if number in self._begun or not 0 <= number < len(self._nodes):
            raise ValueError(f"node {number} hangs on itself or is not there")
        self._begun.add(number)
        self._built[number] = self._build(number, self._nodes[number])
        return self._built[number]

    def _build(self, number: int, node: dict[str, Any]) -> Any:
        if "class" in node:
            return self._object(number, node)
        if "array" in node or "number" in node:
            return self._array(node)
        if "numbers" in node:
            keys, values = (self.value(part).tolist() for part in node["numbers"])
            return dict(zip(keys, values, strict=True))
        if "dict" in node:
            return {self.value(key): self.value(item) for key, item in node["dict"]}
        ((kind, items),) = node.items()
        return {"list": list, "tuple": tuple}[kind](map(self.value, items))

    def _object(self, number: int, node: dict[str, Any]) -> Any:
        cls = _class(node["class"])
        made: Any = object.__new__(cls)
        self._built[number] = made
        state = {name: self.value(part) for name, part in node["state"].items()}
        if dataclasses.is_dataclass(cls):
            missing = {field.name for field in dataclasses.fields(cls)} - set(state)
            if missing:
                raise ValueError(f"a {cls.__name__} lacks {', '.join(sorted(missing))}")
        if hasattr(cls, "__setstate__"):
            made.__setstate__(state)
        else:
            made.__dict__.update(state)
        return made

    def _array(self, node: dict[str, Any]) -> Any:
        kind = node["array"] if "array" in node else node["number"]
        shape = tuple(int(n) for n in node["shape"])
        size, at = int(np.prod(shape, dtype=object)), int(node["at"])
        if min(shape, default=0) < 0 or at < 0 or at + size > len(self._arrays[kind]):
            raise ValueError(f"an array of shape {shape} is not there")
        values = self._arrays[kind][at : at + size].copy().reshape(shape, order=node["order"])
        return values if "array" in node else values[()]


def save_state(
    path: Path, root: Any, about: dict[str, Any], left_out: tuple[str, ...] = ()
) -> None:
    """Save an object with all that it holds.

    Parameters
    ----------
    path : Path
        The file; it appears whole or not at all, and the same object gives the same bytes.
    root : object
        Of a class of relmap.
    about : dict
        What else the file should tell, fit for JSON.
    left_out : tuple of str
        Attributes that are saved as None.

    Raises
    ------
    RelmapError
        Where the file cannot be written.
    """
    from relmap.io.files import atomic_write

    writer = _Writer(left_out)
    content = {"format": FORMAT, **about, "root": writer.value(root), "nodes": writer.nodes}
    text = np.frombuffer(json.dumps(content).encode(), dtype=np.uint8)
    packed = io.BytesIO()
    arrays: dict[str, Any] = {_GRAPH: text, **writer.arrays()}
    np.savez(packed, **arrays)
    atomic_write(path, packed.getvalue())


def load_state(path: Path, cls: type, saved_by: str = "versions") -> Any:
    """Load an object of a class from a file that `save_state` wrote.

    Raises
    ------
    RelmapError
        Where there is no such file, it is damaged, or it holds something else.
    """
    if not path.is_file():
        raise RelmapError(f"there is no saved map {path}, expected one that 'relmap map' wrote")
    try:
        arrays = _read_arrays(path)
        content = json.loads(arrays.pop(_GRAPH).tobytes())
        version = content["format"]
        if isinstance(version, int) and version > FORMAT:
            raise RelmapError(
                f"saved map {path} is of version {version}, and this relmap reads up to {FORMAT}"
            )
        root = _Reader(content["nodes"], arrays).value(content["root"])
        if type(root) is not cls:
            raise RelmapError(f"{path} holds a {type(root).__name__}, not a {cls.__name__}")
        _check_attributes(root, cls(), content.get(saved_by))
    except _WRONG as error:
        raise RelmapError(
            f"saved map {path} is damaged or none, or of another version of relmap: {reason(error)}"
        ) from error
    return root


def _class(name: str) -> type:
    """Return one of relmap's own classes."""
    module, _, qualname = name.partition(":")
    if not module.startswith(PACKAGES) or not qualname.isidentifier():
        raise ValueError(f"{name!r} is no part of a mapper")
    cls = getattr(import_module(module), qualname)
    if not isinstance(cls, type) or cls.__module__ != module:
        raise ValueError(f"{name!r} is no part of a mapper")
    return cls


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file.  They are not compressed, so none is larger than the file."""
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if member.compress_type != zipfile.ZIP_STORED or name not in (_GRAPH, *KINDS):
                raise ValueError(f"{member.filename!r} is not part of a saved map")
            arrays[name] = _flat_array(archive.read(member), "uint8" if name == _GRAPH else name)
    return arrays


def _flat_array(data: bytes, kind: str) -> NDArray[Any]:
    """Return the array in an ``.npy`` file as numpy writes it: flat, of one kind, and whole."""
    head = _HEAD.match(data)
    if head is None:
        raise ValueError(f"an array of {kind} is of another format")
    dtype = np.dtype(head["dtype"].decode())
    values = np.frombuffer(data[head.end() :], dtype=dtype)
    if dtype.name != kind or len(values) != int(head["length"]):
        raise ValueError(f"an array of {kind} is cut short or of another kind")
    return values


def _check_attributes(loaded: Any, fresh: Any, versions: Any) -> None:
    """Make sure that a loaded object has the parts that this relmap gives it.

    Raises
    ------
    RelmapError
        Where another version of relmap saved it.
    """
    if not type(fresh).__module__.startswith(PACKAGES):
        return
    has, needs = loaded.__getstate__() or {}, fresh.__getstate__() or {}
    if type(loaded) is type(fresh) and has.keys() != needs.keys():
        raise RelmapError(
            f"the saved map is of another relmap ({versions}): parts of its "
            f"{type(fresh).__name__} differ; map its log again"
        )
    if type(loaded) is type(fresh):
        for name, part in needs.items():
            _check_attributes(has[name], part, versions)
