"""Compilation: what is compiled, where it is cached, and the message about it."""

from __future__ import annotations

import ast
import os
import re
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


def is_helper(node: ast.AST) -> bool:
    """Return whether it is a function that is compiled as a part of others."""
    return "helper" in decorators(node)


def module_of(path: Path) -> str:
    return ".".join(("relmap", *path.relative_to(PACKAGE).with_suffix("").parts))


def test_helpers_are_called_by_compiled_code_alone() -> None:
    """To call one from Python would crash."""
    helpers, trees = set[tuple[str, str]](), dict[Path, ast.Module]()
    sources = {path: path.read_text() for path in PACKAGE.rglob("*.py")}
    for path, source in sources.items():
        if "helper" in source:
            trees[path] = ast.parse(source)
            found = (node for node in ast.walk(trees[path]) if isinstance(node, ast.FunctionDef))
            helpers |= {(module_of(path), node.name) for node in found if is_helper(node)}
    assert len(helpers) > 20
    named = re.compile("|".join(rf"\b{name}\b" for _, name in helpers))
    for path, source in sources.items():
        if named.search(source):
            tree = trees.get(path) or ast.parse(source)
            imported = {
                (node.module, alias.name)
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom)
                for alias in node.names
            }
            names = {name for where, name in helpers & imported} | {
                name for where, name in helpers if where == module_of(path)
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
    for _ in range(2 if home == "a folder" else 1):
        done = subprocess.run(
            [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.endswith("\n6.0\n")
        lines += [line for line in done.stderr.splitlines() if "relmap: compiling" in line]
    (line,) = lines
    how_often = "only on the first" if home == "a folder" else "in every"
    assert f"{how_often} run" in line
    assert ("unless NUMBA_CACHE_DIR" in line) == (home == "none")
    assert bool(list(user.glob(".cache/**/*.nbi"))) == (home == "a folder")


def test_code_is_compiled_again_if_what_it_uses_changed_and_only_then(tmp_path: Path) -> None:
    """numba by itself looks only at the time stamp of the file of the function."""
    parts = """
from numba.extending import intrinsic
from relmap.core.linalg.compiling import helper

OFFSET = 1.0

@helper
def scaled(x: float) -> float:
    return 2 * x

@intrinsic
def negative(_, x):
    return x(x), in_llvm

def in_llvm(context, builder, signature, given):
    return builder.fneg(given[0])
"""
    kernel = KERNEL.replace("return 2 * x", "return negative(scaled(x)) + OFFSET")
    kernel = "from parts import OFFSET, negative, scaled" + kernel
    (tmp_path / "parts.py").write_text(parts)
    (tmp_path / "kernel.py").write_text(kernel)
    paths = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    environment = os.environ | {"PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def result() -> tuple[float, float]:
        """Return the result, and when the code was written."""
        # -B: Python itself would take files of equal size and second for the same.
        run = [sys.executable, "-B", "-c", "import kernel; print(kernel.doubled(3.0))"]
        done = subprocess.run(run, env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout), max(at.stat().st_mtime_ns for at in tmp_path.rglob("*.nbc"))

    first, at = result()
    assert first == -5
    (tmp_path / "kernel.py").touch()
    (tmp_path / "parts.py").write_text(parts + "\n# a comment\n")
    assert result() == (-5, at)
    changes = ("1.0", "5.0", -1), ("2 * x", "3 * x", -4), ("builder.fneg(given[0])", "given[0]", 14)
    for old, new, expected in changes:
        parts = parts.replace(old, new)
        (tmp_path / "parts.py").write_text(parts)
        found, at = result()
        assert found == expected
    (tmp_path / "kernel.py").write_text(kernel.replace("compiled", "unrolled"))
    assert result()[1] > at


def test_kept_code_is_loaded_without_what_only_compiling_needs(tmp_path: Path) -> None:
    """Functions that call each other, too, whichever is compiled first."""
    kernel = (
        KERNEL
        + """
@compiled
def quadrupled(x: float) -> float:
    return doubled(doubled(x))
"""
    )
    (tmp_path / "kernel.py").write_text(kernel)
    paths = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    environment = os.environ | {"PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    run = """
import sys
from kernel import doubled, quadrupled
print(*(one(3.0) for one in FUNCTIONS), "numba.np.arraymath" in sys.modules)
"""
    for first, expected in (
        ("quadrupled", "12.0 True"),
        ("doubled", "6.0 True"),
        ("doubled, quadrupled", "6.0 12.0 False"),
    ):
        command = [sys.executable, "-c", run.replace("FUNCTIONS", f"({first},)")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.split() == expected.split()
