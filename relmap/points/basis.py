"""The consistent basis of a group of points, and its relative map (section III, Fig. 8).

B0 is the point farthest from the centre, B1 the farthest from B0, and in space B2 the farthest from
the line through both. B0 is the origin, B1 lies on the negative x axis, and in space B2 in the xz
plane, at positive z.
"""

from __future__ import annotations

from relmap.core.arrays import Floats


def relative_map(block: Floats) -> Floats | None:
    """Average a group's locations in its consistent basis (section III).

    `block` (g, i, d), robot frame, metres: every member seen in every iteration. Returns (g, d),
    group frame, metres, or None if the group determines no basis.
    """
    from relmap.points.basis_kernels import average_in_basis

    mean, is_determined = average_in_basis(block)
    return mean if is_determined else None
