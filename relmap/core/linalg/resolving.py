# mypy: disable-error-code="no-untyped-call"
# ruff: noqa: D102 -- the methods are those of numba
"""What calls within loops stand for, found once for each kind of arguments.

New arrays, extremes of numbers and whole numbers are made in place: numba would compile a function
for each form of a call of `np.empty`, `max` or `int`.
"""

from __future__ import annotations

import operator
from typing import Any, ClassVar, cast

import numpy as np
from numba.core import cgutils, types, typing
from numba.core.imputils import lower_builtin
from numba.core.typing.npydecl import parse_dtype, parse_shape
from numba.core.typing.templates import AbstractTemplate, CallableTemplate, signature
from numba.cpython.builtins import do_minmax
from numba.np import arrayobj


class _Empty(CallableTemplate):
    key = "relmap.empty"

    def generic(self) -> Any:
        def typer(shape: Any, dtype: Any = None) -> Any:
            is_float = dtype is None or getattr(dtype, "typing_key", None) is float
            kind = types.float64 if is_float else parse_dtype(dtype)
            dimensions = parse_shape(shape)
            return types.Array(kind, dimensions, "C") if kind and dimensions else None

        return typer


class _Zeros(_Empty):
    key = "relmap.zeros"


class _Ones(_Empty):
    key = "relmap.ones"


def _empty(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    made, shape = types.TypeRef(signature.return_type), signature.args[0]
    _, code = cast("Any", arrayobj).numpy_empty_nd.__wrapped__(None, shape, types.none, made)
    return code(context, builder, signature, args)


def _zeros(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    made = _empty(context, builder, signature, args)
    part = context.data_model_manager[signature.return_type]
    data, count, size = (part.get(builder, made, name) for name in ("data", "nitems", "itemsize"))
    cgutils.memset(builder, data, builder.mul(count, size), 0)
    return made


def _ones(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    made = _empty(context, builder, signature, args)
    part = context.data_model_manager[signature.return_type]
    data, count = (part.get(builder, made, name) for name in ("data", "nitems"))
    with cgutils.for_range(builder, count) as loop:
        builder.store(data.type.pointee(1), builder.gep(data, [loop.index]))
    return made


class _Largest(AbstractTemplate):
    key = "relmap.max"

    def generic(self, args: Any, kws: Any) -> Any:
        if kws or not all(isinstance(one, types.Number) for one in args):
            return None
        return signature(self.context.unify_types(*args), *args)


class _Least(_Largest):
    key = "relmap.min"


class _Whole(_Largest):
    key = "relmap.int"

    def generic(self, args: Any, kws: Any) -> Any:
        if kws or len(args) != 1 or not isinstance(args[0], types.Number | types.Boolean):
            return None
        is_whole = isinstance(args[0], types.Integer)
        return signature(args[0] if is_whole else types.intp, *args)


def _largest(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return do_minmax(context, builder, signature.args, args, operator.gt)


def _least(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return do_minmax(context, builder, signature.args, args, operator.lt)


def _whole(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return context.cast(builder, args[0], signature.args[0], signature.return_type)


cast("Any", lower_builtin)(_Largest.key, types.VarArg(types.Number))(_largest)
cast("Any", lower_builtin)(_Least.key, types.VarArg(types.Number))(_least)
cast("Any", lower_builtin)(_Whole.key, types.Any)(_whole)
for _form in [types.Any], [types.Any, types.Any]:
    cast("Any", lower_builtin)(_Empty.key, *_form)(_empty)
    cast("Any", lower_builtin)(_Zeros.key, *_form)(_zeros)
    cast("Any", lower_builtin)(_Ones.key, *_form)(_ones)


class Resolved(cast("Any", typing).Context):  # type: ignore[misc]
    """What numba knows of types, with a memory for the functions that were resolved."""

    memory: ClassVar[dict[object, Any]] = {}
    made: ClassVar[dict[str, Any]] = {
        "empty": types.Function(_Empty),
        "zeros": types.Function(_Zeros),
        "ones": types.Function(_Ones),
        "max": types.Function(_Largest),
        "min": types.Function(_Least),
        "int": types.Function(_Whole),
    }

    def __init__(self, known: Any) -> None:
        """Share all of `known`."""
        self.__dict__.update(known.__dict__)
        self._known = known

    def resolve_value_type(self, val: Any) -> Any:
        is_made = val is max or val is min or val is int
        return self.made[val.__name__] if is_made else self._known.resolve_value_type(val)

    def resolve_getattr(self, typ: Any, attr: str) -> Any:
        if isinstance(typ, types.Module) and typ.pymod is np and attr in self.made:
            return self.made[attr]
        return self._known.resolve_getattr(typ, attr)

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        if kws or isinstance(func, (str, types.Dispatcher)):
            return self._known.resolve_function_type(func, args, kws)
        key = func, tuple(args)
        found = self.memory.get(key) or self._known.resolve_function_type(func, args, kws)
        if found is not None:  # a function that is compiled later may be found then
            self.memory[key] = found
        return found

    def resolve_setitem(self, target: Any, index: Any, value: Any) -> Any:
        return self.resolve_function_type(operator.setitem, (target, index, value), {})
