"""The state of an engine as named columns, for saving and restoring.

A part of the engine lists its state attributes in `STATE`, as ``_attribute``, saved without the
underscore, or ``name=attribute``; for a dataclass without `STATE` it is all fields. The type of an
attribute is given by its annotation in the class, or else by its value in a new part. A list or
dictionary of arrays, or of records or tuples of arrays and numbers, has one column for each of
them, with the number of rows of each array.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Ints
from relmap.core.state.growing import GrowingArray

PLAIN = {bool: (bool,), int: (int,), float: (float, int), str: (str,), NoneType: ()}
"""Types of plain values, and their allowed JSON types."""
NUMBERS = (bool, int, float)


class OtherColumnsError(ValueError):
    """A state lacks columns, or has unknown ones."""


@cache
def _members(cls: Any) -> dict[str, tuple[str, Any]]:
    """Return attribute and annotation, if any, of each state entry of a part, by name."""
    found, hints = {}, get_type_hints(cls)
    for entry in cls.STATE.split() if hasattr(cls, "STATE") else [f.name for f in fields(cls)]:
        name, _, attribute = entry.rpartition("=")
        of_class = getattr(cls, attribute, None)
        function = getattr(of_class, "fget", None) or getattr(of_class, "func", None)
        hint = get_type_hints(function)["return"] if function else hints.get(attribute)
        found[name or attribute.lstrip("_")] = attribute, hint
    return found


def _kind(hint: Any, now: Any) -> tuple[type, tuple[Any, ...]]:
    """Return the type of an annotation, without None, and its arguments."""
    if hint is None:
        return type(now), ()
    kinds = [kind for kind in get_args(hint) if kind is not NoneType]
    if NoneType in get_args(hint):
        (hint,) = kinds
    return get_origin(hint) or hint, get_args(hint)


def _entries(hint: Any) -> dict[str, Any]:
    """Return the types of the entries of a record or a tuple by name; none for other types."""
    kind, of = _kind(hint, None)
    if kind is tuple:
        return {str(k): entry for k, entry in enumerate(of)}
    if not is_dataclass(kind) or hasattr(kind, "STATE"):
        return {}
    return {name: entry for name, (_, entry) in _members(kind).items()}


def _is_flat(hint: Any) -> bool:
    """Return whether a type is an array, or a record or tuple of arrays and numbers."""
    if get_origin(hint) is np.ndarray:
        return True
    entries = () if NoneType in get_args(hint) else _entries(hint).values()
    return bool(entries) and all(entry in NUMBERS or _is_flat(entry) for entry in entries)


class StateWriter:
    """Collects the columns of parts.

    `columns`: arrays and JSON values, by names such as ``landmarks/position``.
    """

    def __init__(self) -> None:
        self.columns: dict[str, Any] = {}
        self._done: list[Any] = []

    def add(self, part: Any, prefix: str = "") -> None:
        """Add a part or a record; an object shared by two parts is added once."""
        if any(part is other for other in self._done):
            return
        self._done += [part] if hasattr(type(part), "STATE") else []
        for name, (attribute, hint) in _members(part.__class__).items():
            self._add(prefix + name, getattr(part, attribute), hint)

    def _add(self, name: str, value: Any, hint: Any) -> None:
        kind, of = _kind(hint, value)
        if value is None or kind in PLAIN:
            self.columns[name] = value.item() if isinstance(value, np.generic) else value
        elif kind in (np.ndarray, GrowingArray):
            self.columns[name] = value if isinstance(value, np.ndarray) else value.values
        elif kind is dict:
            self._add_dict(name, value, *of)
        elif kind is list and of and _is_flat(of[0]):
            self._add_each(name, value, of[0])
        elif kind in (list, tuple, set) and set(of) <= set(PLAIN):
            self.columns[name] = sorted(value) if kind is set else list(value)
        elif kind in (list, tuple):
            self.columns[name] = len(value)
            for k, item in enumerate(value):
                self._add(f"{name}/{k}", item, of[k if kind is tuple else 0])
        else:
            self.add(value, f"{name}/")

    def _add_dict(self, name: str, values: dict[Any, Any], key_type: Any, of: Any) -> None:
        if key_type is str:
            for key, column in values.items():
                self._add(f"{name}/{key}", column, None)
        elif of is int or get_origin(of) is list:
            self.columns[name] = _rows(values)
        else:
            self.columns[f"{name}/number"] = np.array(list(values), dtype=np.int64)
            self._add_each(name, list(values.values()), of)

    def _add_each(self, name: str, items: list[Any], hint: Any) -> None:
        """Add the columns of items of one flat type."""
        if hint in NUMBERS:
            self.columns[name] = np.array(items, dtype=hint)
        elif get_origin(hint) is np.ndarray:
            self.columns[f"{name}_rows"] = np.array([len(a) for a in items], dtype=np.int64)
            if items:
                self.columns[name] = np.concatenate(items)
        elif not _entries(hint):
            raise TypeError(f"{name}: {hint} cannot be saved")
        for key, entry in _entries(hint).items():
            values = [each[int(key)] if key.isdigit() else getattr(each, key) for each in items]
            self._add_each(f"{name}/{key}", values, entry)


def _rows(lists: dict[int, Any]) -> Ints:
    """Return the numbers (n, 2) in a dictionary: key and value, or key and each list entry."""
    rows = [
        (key, item)
        for key, value in lists.items()
        for item in (value if isinstance(value, list) else (value,))
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


class StateReader:
    """Restores the state of new parts from columns.

    Invalid columns raise ValueError or another error caused by wrong values.

    `columns`: as written by a `StateWriter`.
    """

    def __init__(self, columns: dict[str, Any]) -> None:
        self._columns = columns.copy()
        self._done: list[Any] = []

    def end(self) -> None:
        """Check that no column is left over."""
        if self._columns:
            raise OtherColumnsError(f"{min(self._columns)} is unknown")

    def restore(self, part: Any, prefix: str = "") -> None:
        """Restore the state of a new part."""
        if any(part is other for other in self._done):
            return
        self._done.append(part)
        for name, (attribute, hint) in _members(part.__class__).items():
            now = getattr(part, attribute)
            setattr(part, attribute, self._value(prefix + name, hint, now, part))
        if hasattr(part, "restored"):
            part.restored()

    def _value(self, name: str, hint: Any, now: Any, part: Any = None) -> Any:
        kind, of = _kind(hint, now)
        if self._columns.get(name, self) is None and (now is None or NoneType in get_args(hint)):
            return self._columns.pop(name)
        if kind in PLAIN:
            return self._plain(name, kind)
        if kind is np.ndarray:
            dtype = get_args(of[1])[0] if of else now.dtype
            return self._array(name, dtype, getattr(now, "ndim", None))
        if kind is GrowingArray:
            now.hold(self._array(name, now.values.dtype, now.values.ndim))
            return now
        if kind is dict and of[0] is str:
            return {key: self._value(f"{name}/{key}", None, value) for key, value in now.items()}
        if kind is dict:
            return self._dict(name, of[1])
        if kind is list and of and _is_flat(of[0]):
            return self._each(name, of[0])
        if kind in (list, tuple, set):
            return kind(self._items(name, kind, of))
        if hasattr(kind, "STATE") and not is_dataclass(kind):
            made = now if now is not None else kind() if part is None else part.blank()
            self.restore(made, f"{name}/")
            return made
        return self._record(kind, f"{name}/")

    def _take(self, name: str) -> Any:
        if name not in self._columns:
            raise OtherColumnsError(f"{name} is missing")
        return self._columns.pop(name)

    def _plain(self, name: str, kind: Any) -> Any:
        value = self._take(name)
        if type(value) not in PLAIN[kind]:
            raise ValueError(f"{name} is {value!r:.40}, not {kind.__name__}")
        return value

    def _array(self, name: str, dtype: Any, ndim: int | None) -> NDArray[Any]:
        value = self._take(name)
        if not isinstance(value, np.ndarray) or value.dtype != dtype:
            raise ValueError(f"{name} is not of {np.dtype(dtype).name}")
        if value.ndim != (ndim or value.ndim):
            raise ValueError(f"{name} has shape {value.shape}, and not {ndim} dimensions")
        return value

    def _dict(self, name: str, of: Any) -> dict[int, Any]:
        if of is not int and get_origin(of) is not list:
            numbers = self._array(f"{name}/number", np.int64, 1).tolist()
            return dict(zip(numbers, self._each(name, of), strict=True))
        rows = self._array(name, np.int64, 2).reshape(-1, 2).tolist()
        if of is int:
            return dict(rows)
        found: dict[int, list[int]] = {}
        for key, item in rows:
            found.setdefault(key, []).append(item)
        return found

    def _each(self, name: str, hint: Any) -> list[Any]:
        """Return items of one flat type, whose columns are stored concatenated."""
        if hint in NUMBERS:
            found: list[Any] = self._array(name, np.dtype(hint), 1).tolist()
            return found
        if get_origin(hint) is np.ndarray:
            sizes = self._array(f"{name}_rows", np.int64, 1)
            values = self._value(name, hint, None) if len(sizes) else np.empty(0)
            ends = np.append(0, np.cumsum(sizes)).tolist()
            if ends[-1] != len(values) or (sizes < 0).any():
                raise ValueError(f"{name} has {len(values)} rows, and not {ends[-1]}")
            return [values[begin:end] for begin, end in itertools.pairwise(ends)]
        columns = [self._each(f"{name}/{key}", entry) for key, entry in _entries(hint).items()]
        kind, _ = _kind(hint, None)
        rows = zip(*columns, strict=True)
        return list(rows) if kind is tuple else [kind(*row) for row in rows]

    def _items(self, name: str, kind: type, of: tuple[Any, ...]) -> Iterable[Any]:
        if set(of) <= set(PLAIN):
            values = self._take(name)
            allowed = PLAIN[of[0]]
            if type(values) is not list or any(type(value) not in allowed for value in values):
                raise ValueError(f"{name} is not a list of {of[0].__name__}")
            return values
        n = self._plain(name, int)
        if kind is tuple and n != len(of):
            raise ValueError(f"{name} has {n} entries, and not {len(of)}")
        which = itertools.repeat(of[0], n) if kind is list else of
        return [self._value(f"{name}/{k}", hint, None) for k, hint in enumerate(which)]

    def _record(self, cls: type, prefix: str) -> Any:
        made: Any = object.__new__(cls)
        values: dict[str, Any] = {field.name: None for field in fields(cls)}
        for name, (attribute, hint) in _members(cls).items():
            values[attribute] = self._value(prefix + name, hint, None)
        made.__dict__.update(values)
        return made
