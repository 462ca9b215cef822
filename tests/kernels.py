"""Compiled helpers, which only compiled code calls, for Python to call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from relmap.core.linalg.compiling import compiled

Function = TypeVar("Function", bound=Callable[..., object])


def callable_here(helper: Function) -> Function:
    """Return a helper compiled by itself."""
    return cast("Function", compiled(cast("Any", helper).py_func))
