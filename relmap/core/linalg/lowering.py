# mypy: disable-error-code="no-untyped-call"
# ruff: noqa: D102 -- the methods are those of numba
"""Code for loops, entries of arrays and counted references, as short as possible.

Compile time follows the amount of code. By default numba writes some 45 instructions for an entry
of an array, 110 for a loop and a dozen to count a reference, of which nearly all are removed later.
"""

from __future__ import annotations

import operator
from copy import copy
from functools import cache
from typing import Any, cast

import numpy as np
from llvmlite.ir import Undefined
from numba.core import cgutils, ir, ir_utils, types
from numba.core.callconv import CPUCallConv
from numba.core.cpu import CPUContext
from numba.core.lowering import Lower
from numba.core.pythonapi import PythonAPI
from numba.core.runtime.context import NRTContext
from numba.np import arrayobj


@cache
def _size(kind: Any, target: Any) -> int:
    return cast("int", kind.get_abi_size(target))


@cache
def _has_count(models: Any, kind: Any) -> bool:
    return cast("bool", models[kind].contains_nrt_meminfo())


class _Api(PythonAPI):
    """Hands results to Python; by default the type of an array would be looked up for each."""

    def get_env_manager(self, *parts: Any) -> Any:
        self._constants = super().get_env_manager(*parts)
        return self._constants

    def serialize_object(self, obj: Any) -> Any:
        return obj if obj is np.ndarray else super().serialize_object(obj)

    def unserialize(self, structptr: Any) -> Any:
        if structptr is np.ndarray:
            return self._constants.read_const(self._constants.add_const(np.ndarray))
        return super().unserialize(structptr)


class _Counts(NRTContext):
    """Counts references; by default every part of an array would be read to find its count."""

    def get_meminfos(self, builder: Any, ty: Any, val: Any) -> Any:
        models = self._context.data_model_manager
        if not _has_count(models, ty):
            return []
        if isinstance(ty, types.Array):
            return [(ty, models[ty].get(builder, val, "meminfo"))]
        return super().get_meminfos(builder, ty, val)


class _Calls(CPUCallConv):
    """Calls of compiled functions; by default each would ask whether it is inside of a `try`."""

    def return_status_propagate(self, builder: Any, status: Any) -> None:
        builder.store(status.excinfoptr, self._get_excinfo_argument(builder.function))
        builder.ret(status.code)


class _Context(CPUContext):
    """What the code of numba's functions is written with."""

    @property
    def call_conv(self) -> Any:
        return _Calls(self)

    def get_abi_sizeof(self, ty: Any) -> int:
        return _size(ty, self.target_data)

    def get_returned_value(self, builder: Any, ty: Any, val: Any) -> Any:
        return val if isinstance(ty, types.Array) else super().get_returned_value(builder, ty, val)

    def get_return_value(self, builder: Any, ty: Any, val: Any) -> Any:
        return val if isinstance(ty, types.Array) else super().get_return_value(builder, ty, val)


class ShortLower(Lower):
    """The step from typed code to LLVM; what is not overridden is as by default."""

    def __init__(self, context: Any, *parts: Any, **named: Any) -> None:
        shorter = copy(context)
        shorter.__class__ = _Context
        shorter.nrt = _Counts(shorter, context.enable_nrt)
        super().__init__(shorter, *parts, **named)

    def create_cpython_wrapper(self, release_gil: bool = False) -> None:
        context = self.context
        self.context = context.subtarget(get_python_api=lambda builder: _Api(context, builder))
        super().create_cpython_wrapper(release_gil)
        self.context = context

    def delvar(self, name: str) -> None:
        if _has_count(self.context.data_model_manager, self.typeof(name)):
            super().delvar(name)

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        kind = self.typeof(name)
        if name in self._singly_assigned_vars or _has_count(self.context.data_model_manager, kind):
            super().storevar(value, name, argidx)
        else:
            self._alloca_var(name, kind)
            self.builder.store(value, self.getvar(name))

    def alloca_lltype(self, name: str, lltype: Any, datamodel: Any = None) -> Any:
        return cgutils.alloca_once(self.builder, lltype, name=name, zfill=False)

    def lower_binop(self, resty: Any, expr: Any, op: Any) -> Any:
        is_typed = op is expr.fn and expr.static_lhs is expr.static_rhs is ir.UNDEFINED
        if not is_typed:
            return super().lower_binop(resty, expr, op)
        signature = self.fndesc.calltypes[expr]
        if op is operator.pow and signature.args[0] == resty == types.float64:
            power = ir_utils.guard(ir_utils.find_const, self.func_ir, expr.rhs)
            if power in (2, 3):  # by default a loop over the bits of the exponent
                base = self._cast_var(expr.lhs, resty)
                square = self.builder.fmul(base, base)
                return square if power == 2 else self.builder.fmul(base, square)
        function = self.context.typing_context.resolve_value_type(op)
        code = self.context.get_function(function, signature)
        sides = zip((expr.lhs, expr.rhs), signature.args, strict=True)
        result = code(self.builder, [self._cast_var(side, kind) for side, kind in sides])
        return self.context.cast(self.builder, result, signature.return_type, resty)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        at = self._entry(value, index, signature)
        if at is None:
            return super().lower_getitem(resty, expr, value, index, signature)
        entry = arrayobj.load_item(self.context, self.builder, signature.args[0], at)
        return self.context.cast(self.builder, entry, signature.return_type, resty)

    def lower_setitem(self, target: Any, index: Any, value: Any, signature: Any) -> Any:
        at = self._entry(target, index, signature)
        if at is None:
            return super().lower_setitem(target, index, value, signature)
        array = signature.args[0]
        entry = self._cast_var(value, signature.args[2])
        entry = self.context.cast(self.builder, entry, signature.args[2], array.dtype)
        return arrayobj.store_item(self.context, self.builder, array, entry, at)

    def _entry(self, variable: Any, index: Any, signature: Any) -> Any:
        """Return a pointer to an entry of a contiguous array, None if it is something else."""
        kind, places = signature.args[:2]
        is_contiguous = isinstance(kind, types.Array) and kind.layout == "C"
        if self.context.enable_boundscheck or not is_contiguous:
            return None
        is_one = kind.ndim == 1 and places == types.intp
        if not is_one and places != types.UniTuple(types.intp, kind.ndim):
            return None
        array, at = self._cast_var(variable, kind), self._cast_var(index, places)
        at = [at] if is_one else cgutils.unpack_tuple(self.builder, at)
        shape = cgutils.unpack_tuple(self.builder, self._part(kind, array, "shape"))
        data = self._part(kind, array, "data")
        return cgutils.get_item_pointer2(
            self.context, self.builder, data, shape, None, "C", at, wraparound=True
        )

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        if expr.op == "getiter" and self._is_range_by_one(expr.value):
            return self._begin(resty, self.loadvar(expr.value.name))
        if expr.op == "iternext" and self.typeof(expr.value.name) == types.range_iter64_type:
            return self._next(resty, self.typeof(expr.value.name), self.loadvar(expr.value.name))
        if expr.op in ("pair_first", "pair_second"):
            pair = self.loadvar(expr.value.name)
            part = self._part(self.typeof(expr.value.name), pair, expr.op.removeprefix("pair_"))
            self.incref(resty, part)
            return part
        if expr.op == "getattr":
            kind = self.typeof(expr.value.name)
            if isinstance(kind, types.Array) and expr.attr == "shape":
                return self._part(kind, self.loadvar(expr.value.name), "shape")
            if isinstance(kind, types.Module) and isinstance(resty, types.Function):
                return self.context.get_dummy_value()
        return super().lower_expr(resty, expr)

    def _lower_call_normal(self, function: Any, expr: Any, signature: Any) -> Any:
        if getattr(function, "typing_key", None) is len and isinstance(
            signature.args[0], types.Array
        ):
            shape = self._part(signature.args[0], self.loadvar(expr.args[0].name), "shape")
            return self.builder.extract_value(shape, 0)
        return super()._lower_call_normal(function, expr, signature)

    def _is_range_by_one(self, variable: Any) -> bool:
        if self.typeof(variable.name) != types.range_state64_type:
            return False
        call = ir_utils.guard(ir_utils.get_definition, self.func_ir, variable)
        if getattr(call, "op", "") != "call" or call.vararg or len(call.args) > 2:
            return False
        callee = ir_utils.guard(ir_utils.get_definition, self.func_ir, call.func)
        return isinstance(callee, ir.Global) and callee.value is range

    def _begin(self, kind: Any, bounds: Any) -> Any:
        builder = self.builder
        start, stop, step = cgutils.unpack_tuple(builder, bounds)
        at, left = (cgutils.alloca_once(builder, start.type) for _ in range(2))
        builder.store(start, at)
        count = builder.sub(stop, start)
        is_empty = builder.icmp_signed("<", count, count.type(0))
        builder.store(builder.select(is_empty, count.type(0), count), left)
        return self._whole(kind, iter=at, stop=stop, step=step, count=left)

    def _next(self, pair: Any, kind: Any, iterator: Any) -> Any:
        builder = self.builder
        at, step, left = (self._part(kind, iterator, name) for name in ("iter", "step", "count"))
        value, count = builder.load(at), builder.load(left)
        builder.store(builder.add(value, step), at)
        builder.store(builder.sub(count, count.type(1)), left)
        is_valid = builder.icmp_signed(">", count, count.type(0))
        return self._whole(pair, first=value, second=is_valid)

    def _part(self, kind: Any, value: Any, name: str) -> Any:
        return self.context.data_model_manager[kind].get(self.builder, value, name)

    def _whole(self, kind: Any, **parts: Any) -> Any:
        model = self.context.data_model_manager[kind]
        whole = model.get_value_type()(Undefined)
        for name, part in parts.items():
            whole = self.builder.insert_value(whole, part, model.get_field_position(name))
        return whole
