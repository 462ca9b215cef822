# mypy: disable-error-code="no-untyped-call, untyped-decorator"
"""The distance of a point from the surfaces around a beam, in vectors.

LLVM does not vectorise the loop over so few, as the order in which it finds the minimum is fixed.
"""

from __future__ import annotations

from typing import Any

from llvmlite.ir import Constant, IntType, Undefined, VectorType
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

BESIDE = 3
"""Number of beams on either side of a point whose surface it is compared with."""
LANES = 2 * BESIDE + 2
"""Surfaces that are read for each point, of which the last one is not used."""
_INDEX = IntType(32)
_in_llvm: Any = intrinsic  # the annotations are those of functions that Python calls


@_in_llvm
def squared_nearest(_: Any, x: Any, y: Any, lines: Any, first: Any) -> Any:
    """Return the squared distance of a point from the nearest surface, or end of a gap.

    `lines` (6, n): see `beam_kernels.surfaces`; the `first` of the 2 `BESIDE` + 1 surfaces.
    """
    return types.float64(x, y, lines, first), _squared_nearest


def _squared_nearest(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    x, y, lines, first = given
    lanes = VectorType(x.type, LANES)
    array = make_array(signature.args[2])(context, builder, lines)
    n = builder.extract_value(array.shape, 1)

    def column(k: int) -> Any:
        at = builder.gep(array.data, [builder.add(first, builder.mul(n, n.type(k)))])
        return builder.load(builder.bitcast(at, lanes.as_pointer()), align=8)

    def chosen(vector: Any, places: list[int]) -> Any:
        mask = Constant(VectorType(_INDEX, len(places)), places)
        return builder.shuffle_vector(vector, vector, mask)

    def in_all(value: Any) -> Any:
        one = builder.insert_element(Constant(lanes, Undefined), value, _INDEX(0))
        return chosen(one, [0] * LANES)

    def less(a: Any, b: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    def products(a: Any, b: Any, c: Any, d: Any) -> Any:
        return builder.fadd(builder.fmul(a, b), builder.fmul(c, d))

    x, y = builder.fsub(in_all(x), column(0)), builder.fsub(in_all(y), column(1))
    ux, uy, inverse = column(2), column(3), column(4)
    zero, one = (in_all(x.type.element(value)) for value in (0.0, 1.0))
    t = builder.fmul(products(x, ux, y, uy), inverse)
    t = less(builder.select(builder.fcmp_ordered(">", t, zero), t, zero), one)
    off_x, off_y = (builder.fsub(a, builder.fmul(t, u)) for a, u in ((x, ux), (y, uy)))
    far_x, far_y = builder.fsub(x, ux), builder.fsub(y, uy)
    from_ends = less(products(x, x, y, y), products(far_x, far_x, far_y, far_y))
    is_gap = builder.fcmp_ordered("<", inverse, zero)
    off = builder.select(is_gap, from_ends, products(off_x, off_x, off_y, off_y))
    left = [*range(LANES - 1), LANES - 2]
    while len(left) > 1:
        half = len(left) // 2
        off, left = less(chosen(off, left[:half]), chosen(off, left[half:])), [*range(half)]
    return builder.extract_element(off, _INDEX(0))
