"""Compiled code does what Python does, without compiling more than it needs."""

from __future__ import annotations

import runpy
import sys
from importlib import import_module
from types import SimpleNamespace
from typing import Any, cast

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.cpu import CPUContext
from numba.core.runtime import nrt

from relmap.core.linalg import compiler
from relmap.core.linalg.compiling import helper


def afresh(function: Any, compiler: Any = compiler.KernelCompiler) -> Any:
    """Compile as `compiled`, but without a cache, which would hide changes of the compiler."""
    options: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
    return numba.njit(pipeline_class=compiler, **options)(function)


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
