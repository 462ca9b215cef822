"""Compilation: what is compiled, where it is cached, and the message about it."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.compiler import Flags
from numba.core.cpu import CPUContext
from numba.core.runtime import nrt

import relmap
from relmap.core.linalg import compiler
from relmap.core.linalg.compiling import helper

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


def afresh(function: Any, compiler: Any = compiler.KernelCompiler) -> Any:
    """Compile as `compiled`, but without a cache, which would hide changes of the compiler."""
    options: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
    return numba.njit(pipeline_class=compiler, **options)(function)


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


def indexed(rows: np.ndarray, flags: np.ndarray, at: int) -> tuple[float, int, bool, np.ndarray]:
    """Use what the code of loops is shortened for, in all its forms."""
    total, count, marked = 0.0, 0, False
    for i in range(len(rows)):
        row = rows[i]
        for j in range(at, rows.shape[1]):
            total += row[j] * rows[i, -1] - rows[-i, j] ** 2
            if flags[j]:
                break
        else:
            count += 10
        marked |= flags[i]
    for i in range(len(rows) - 1, -1, -2):
        count += i
    for i in range(5, at):
        count += 1000 * i
    turned = rows[:, ::-1].T
    turned[1, 0] += turned[-1, -2]
    for row in turned:
        total += row[0] // 0.3 - row[-1]
    largest = rows
    for k in range(3):
        copy = rows + k
        copy[k, 1:] = rows[k, :-1]
        if k % 2:
            largest = copy
    flags[-1] = count > 7
    return total, count, marked, largest


@pytest.mark.parametrize("at", [-2, 0, 2, 7])
def test_compiled_code_does_what_python_does(at: int) -> None:
    rows, flags = np.random.default_rng(3).normal(size=(4, 4)), np.arange(4) == 2
    here, there = (rows.copy(), flags.copy()), (rows.copy(), flags.copy())
    expected, found = indexed(*here, at), COMPILED(*there, at)
    for one, other in zip((*expected, *here), (*found, *there), strict=True):
        assert np.array_equal(one, other)


def test_ranges_may_come_from_elsewhere() -> None:
    backwards: Any = numba.njit(lambda n: range(n - 1, -1, -1))

    def digits(n: int, bounds: tuple[int, int, int]) -> int:
        number = 0
        for i in backwards(n):
            number = 10 * number + i
        for i in range(*bounds):
            number = 10 * number + i
        return number

    assert afresh(digits)(4, (9, 3, -2)) == 3210975


def test_indices_are_checked_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    with pytest.raises(IndexError):
        afresh(lambda rows: rows[len(rows), 0])(np.ones((4, 4)))


def test_other_versions_of_numba_compile_with_their_own_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba, "version_info", SimpleNamespace(short=(0, 99)))
    for name in ("lowering", "resolving"):
        monkeypatch.setitem(sys.modules, f"relmap.core.linalg.{name}", None)
    other = runpy.run_path(compiler.__file__)["KernelCompiler"]
    here, there = (np.ones((4, 4)), np.zeros(4, bool)), (np.ones((4, 4)), np.zeros(4, bool))
    one = afresh(lambda rows, flags: (rows[1:, 0] + 2 * rows[0, 1:])[flags[1:].argmin()], other)
    assert one(*here) == one.py_func(*there)


def made(n: int) -> tuple[Any, ...]:
    empty = np.empty((n, 2), dtype=np.int64)
    empty[:] = 3
    flags, none = np.ones(n, dtype=np.bool_), np.empty(n, np.uint8)[:0]
    return (
        empty,
        flags,
        none,
        np.zeros(n),
        np.zeros((n, 1, 2), np.bool_),
        np.ones((2, n), dtype=float),
    )


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


def test_new_arrays_are_made_without_compiling_functions_of_numba() -> None:
    here = afresh(made)
    with cast("Any", event).install_recorder("numba:compile") as recorded:
        found = here(3)
    names = [one.data["dispatcher"].py_func.__qualname__ for _, one in recorded.buffer]
    assert not [name for name in names if name.startswith("ol_np_")]
    for one, other in zip(made(3), found, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def numbers(x: float, k: int) -> tuple[float, float, float, int, int]:
    return max(x, k), min(k, x, 2.0), max(np.nan, x), max(k, 3), int(x) + int(k) + int(x > k)


@pytest.mark.parametrize("x", [-2.7, 2.7])
def test_extremes_and_whole_numbers_are_found_as_by_python(x: float) -> None:
    expected, found = numbers(x, 1), afresh(numbers)(x, 1)
    np.testing.assert_array_equal(expected, found)


def test_a_part_that_fails_ends_its_caller_too() -> None:
    part: Any = helper(lambda n: np.empty(n))
    with pytest.raises(ValueError, match="negative"):
        afresh(lambda n: len(part(n)) + 1)(-1)


def test_a_helper_is_compiled_once_whatever_constants_it_gets() -> None:
    raised: Any = helper(lambda base, by: base**by)
    powers = afresh(lambda x, n: raised(x, 2) + raised(x, 3) + raised(x, n))
    assert powers(2.0, 4) == 4 + 8 + 16
    assert len(raised.signatures) == 1


def powers(x: float) -> tuple[float, ...]:
    return x**2, (x + 1) ** 3, x**1, x**4


def test_powers_are_multiplied_out(monkeypatch: pytest.MonkeyPatch) -> None:
    x = 0.1
    assert afresh(powers)(x) == (x * x, (x + 1) * ((x + 1) * (x + 1)), x, x * x * (x * x))
    monkeypatch.setattr(CPUContext, "compile_internal", None)  # would compile a loop over bits
    assert afresh(lambda x: x**2 + x**3)(x) == x * x + x * (x * x)


def test_options_are_compared_as_by_numba() -> None:
    given, quick = cast("Any", Flags)(), compiler.KernelFlags()
    assert hash(given) == hash(quick)
    assert given == quick
    quick.error_model = "numpy"
    assert given != quick
    given.error_model = "numpy"
    assert given == quick == quick.copy()
    assert quick.values() == given.values()


def test_compiled_code_frees_its_arrays() -> None:
    runtime: Any = nrt
    rows, flags = np.ones((4, 4)), np.zeros(4, bool)
    COMPILED(rows, flags, 0)
    import_module("numba.core.runtime._nrt_python").memsys_enable_stats()
    before, counts = runtime.rtsys.get_allocation_stats(), sys.getrefcount(rows)
    for _ in range(10):
        COMPILED(rows, flags, 0)
    after = runtime.rtsys.get_allocation_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0
    assert sys.getrefcount(rows) == counts


COMPILED = afresh(indexed)
