"""Compilation: what is compiled, where it is cached, and the message about it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import relmap

PACKAGE = Path(relmap.__file__).parent
KERNEL = """
from relmap.core.linalg.compiling import compiled


@compiled
def doubled(x: float) -> float:
    return 2 * x
"""
RUN = """
import relmap.cli, folder.kernel
relmap.cli.main(["--version"])
print(folder.kernel.doubled(3.0))
"""


def decorators(node: ast.AST) -> set[str]:
    return {d.id for d in getattr(node, "decorator_list", []) if isinstance(d, ast.Name)}


def is_compiled(node: ast.AST) -> bool:
    return bool(decorators(node) & {"compiled", "helper", "unrolled"})


def compiled_in(source: str) -> set[str]:
    """Return the names of functions that are compiled as parts of others."""
    return {
        node.name
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and "helper" in decorators(node)
    }


def test_helpers_are_called_by_compiled_code_alone() -> None:
    """To call one from Python would crash."""
    sources = {path: path.read_text() for path in PACKAGE.rglob("*.py")}
    helpers = {
        (".".join(("relmap", *path.relative_to(PACKAGE).with_suffix("").parts)), name)
        for path, source in sources.items()
        for name in compiled_in(source)
    }
    assert len(helpers) > 20
    for path, source in sources.items():
        tree = ast.parse(source)
        imported = {
            (node.module, alias.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        module = ".".join(("relmap", *path.relative_to(PACKAGE).with_suffix("").parts))
        names = {name for where, name in helpers & imported} | {
            name for where, name in helpers if where == module
        }
        used = {
            node.id
            for part in tree.body
            if not is_compiled(part)
            for node in ast.walk(part)
            if isinstance(node, ast.Name)
        }
        assert not names & used, path


@pytest.mark.parametrize("home", ["a folder", "none"])
def test_where_the_package_cannot_be_written_code_is_kept_elsewhere_if_anywhere(
    tmp_path: Path, home: str
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernel.py").write_text(KERNEL)
    (folder / "__pycache__").write_text("a file: there can be no such folder, not even for root")
    user = tmp_path / "home"
    user.mkdir()
    if home == "none":
        (user / ".cache").write_text("nor here")
    paths = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR",)}
    environment |= {"PYTHONPATH": paths, "HOME": str(user), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("XDG_CACHE_HOME", None)
    lines: list[str] = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.endswith("\n6.0\n")
        lines += [line for line in done.stderr.splitlines() if "relmap: compiling" in line]
    if home == "a folder":
        (line,) = lines
        assert "only on the first run" in line
    else:
        assert len(lines) == 2
        assert all("in every run, unless NUMBA_CACHE_DIR" in line for line in lines)
    assert bool(list(user.glob(".cache/**/*.nbi"))) == (home == "a folder")
