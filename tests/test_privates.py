"""Names that begin with an underscore are used only in their class or module, also by tests."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDERS = ("relmap", "tests", "benchmarks", "examples")
OUTSIDE = {"os._exit"}
"""Names that the standard library documents in spite of the underscore."""


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def own_names(node: ast.ClassDef) -> set[str]:
    """Return the names that a class defines: methods, fields, and attributes set on `self`."""
    found = set()
    for child in ast.walk(node):
        if isinstance(child, ast.FunctionDef):
            found.add(child.name)
        elif isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store):
            found.add(child.id)
        elif isinstance(child, ast.Attribute) and is_of(child, "self"):
            found.update([child.attr] if isinstance(child.ctx, ast.Store) else [])
    return found


def is_of(node: ast.Attribute, *names: str) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in names


def called(node: ast.Call) -> str:
    """Return the last name of what is called; none if it has no name."""
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


def privates_read(node: ast.AST, own: frozenset[str] = frozenset()) -> Iterator[str]:
    """Yield the private attributes and imports in a source that are of another class or module."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Attribute) and is_private(child.attr):
            if not is_of(child, "self", "cls") and child.attr not in own:
                yield ast.unparse(child)
        elif isinstance(child, ast.ImportFrom):
            yield from (alias.name for alias in child.names if is_private(alias.name))
        elif isinstance(child, ast.Call) and called(child).endswith("etattr"):
            texts = [arg.value for arg in child.args if isinstance(arg, ast.Constant)]
            names = [text.rpartition(".")[2] for text in texts if isinstance(text, str)]
            yield from (name for name in names if is_private(name))
        inside = own | own_names(child) if isinstance(child, ast.ClassDef) else own
        yield from privates_read(child, inside)


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("mapper._journal", ["mapper._journal"]),
        ("mapper.engine._store.rows", ["mapper.engine._store"]),
        ("PlaneSegmenter()._planes(xy)", ["PlaneSegmenter()._planes"]),
        ("from relmap.mapper import _versions", ["_versions"]),
        ("setattr(mapper, '_journal', None)", ["_journal"]),
        ("monkeypatch.setattr('relmap.comparison.compare._run', run)", ["_run"]),
        ("class A:\n def f(self): return self._x", []),
        ("class A:\n def g(self): self._x = 1\n def f(cls): a = cls(); return a._x", []),
        ("class A:\n def f(self, other): return other._x", ["other._x"]),
        ("class A:\n _x: int\ndef f(a): return a._x", ["a._x"]),
        ("mapper.__class__", []),
    ],
)
def test_privates_are_found(source: str, found: list[str]) -> None:
    assert list(privates_read(ast.parse(source))) == found


def test_no_private_is_read_from_outside(repo_root: Path) -> None:
    paths = [path for folder in FOLDERS for path in (repo_root / folder).rglob("*.py")]
    assert len(paths) > 300
    wrong = [
        f"{path.relative_to(repo_root)}: {read}"
        for path in paths
        for read in privates_read(ast.parse(path.read_text(encoding="utf-8")))
        if read not in OUTSIDE
    ]
    assert wrong == []
