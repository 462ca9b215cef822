# mypy: disable-error-code="no-untyped-call"
"""The cache of a compiled function, which is stale once anything that the function uses changed.

By default numba compares the time stamp of the file of the function only. A function compiled into
its callers, or a constant of another module, would be used as it was when the caller was compiled.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from inspect import unwrap
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys

_COMPILER = "caching.py", "compiler.py", "compiling.py", "lowering.py", "resolving.py"


class Kept(CPUDispatcher):
    """A compiled function whose code is kept."""

    def keep_by_content(self, options: str) -> None:
        """Let its cache depend on its content, and on options, instead of its time stamp."""
        self._cache = _Cache(self.py_func, options)


class _Cache(FunctionCache):
    def __init__(self, function: Callable[..., Any], options: str) -> None:
        super().__init__(function)
        given = self.cache_path, self._impl.filename_base
        self._cache_file = _FileByContent(function, options, *given)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return kept code, None if there is none.

        By default numba would first import all that compiling needs, which takes longer.
        """
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


class _FileByContent(IndexDataCacheFile):
    def __init__(self, function: Callable[..., Any], options: str, path: str, base: str) -> None:
        super().__init__(path, base, source_stamp=None)
        self._function, self._options = function, options
        del self._source_stamp  # computed when it is needed: now, some of what is used is missing

    @cached_property
    def _source_stamp(self) -> str:
        stamp = hashlib.sha256(_compiler() + self._options.encode())
        for part in _parts(self._function.__code__, self._function.__globals__, set()):
            stamp.update(part)
        return stamp.hexdigest()


@cache
def _compiler() -> bytes:
    """Return what determines how functions are compiled."""
    return b"".join(Path(__file__).with_name(name).read_bytes() for name in _COMPILER)


def _parts(code: CodeType, names: dict[str, Any], had: set[CodeType]) -> Iterator[bytes]:
    """Yield the code of a function, the constants that it uses, and those of what it calls."""
    had.add(code)
    yield code.co_code
    plain = [one for one in code.co_consts if not isinstance(one, CodeType)]
    yield repr((code.co_names, plain)).encode()
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _parts(one, names, had)
    for name in code.co_names:
        value: Any = names.get(name)
        called = unwrap(value)  # what was compiled, or writes LLVM's code
        if isinstance(called, FunctionType):
            if called.__code__ not in had:
                yield from _parts(called.__code__, called.__globals__, had)
        elif isinstance(value, np.ndarray):
            yield value.tobytes()
        elif isinstance(value, (bool, int, float, str, tuple)):
            yield repr(value).encode()
