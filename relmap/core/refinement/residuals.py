"""Quality of a refined map: residuals of segments and merges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.rows import JointRows


@dataclass(frozen=True, eq=False)
class SegmentResiduals:
    """How well each segment fits the map.

    `first_iteration` (s,); `middle` (s, d), map frame, metres: mean position of the landmarks seen
    in it; `residual` (s,): root mean square deviation from the map, in units of what the noise
    explains.
    """

    first_iteration: Ints
    middle: Floats
    residual: Floats


@dataclass(frozen=True, eq=False)
class MergeResiduals:
    """How well re-observed landmarks fit the ones they were merged into.

    `landmark`, `track` (k,): the landmark, and the number under which it was seen again; `apart_m`
    (k,): distance between the positions seen under this number and under all others; `residual`
    (k,): the same, in units of what the noise explains.
    """

    landmark: Ints
    track: Ints
    apart_m: Floats
    residual: Floats


def residuals_of(
    rows: SegmentRows, joint: JointRows, placed: Floats, positions: Floats, noise_m: float
) -> tuple[SegmentResiduals, MergeResiduals]:
    """Return the residuals of segments and merges.

    Of segments, each sum of squares is compared with its expectation under noise alone. Outliers
    are reported here, even if the refinement gives them little weight.

    `placed` (n, d), map frame, metres: the rows, with each segment fitted to the map; `positions`
    (m, d), map frame, metres: the landmarks.
    """
    (n, d), s = placed.shape, len(joint.segments)
    off = placed - positions[joint.landmark]
    squares = joint.n_seen * np.sum(off**2, axis=1)
    cost = np.bincount(joint.segment, squares, minlength=s)
    each = np.bincount(joint.landmark)
    freedoms = d * np.bincount(joint.segment, weights=1 - 1 / each[joint.landmark], minlength=s)
    expected = noise_m**2 * np.maximum(freedoms - (3 * d - 3), 1)
    ratio = np.divide(cost, expected, out=np.zeros(s), where=expected > 0)
    middle = sums_each(placed, joint.segment, s) / np.diff(joint.begin)[:, None]
    segments = SegmentResiduals(rows.first_iteration[joint.segments], middle, np.sqrt(ratio))
    number, variance = rows.landmark[joint.rows], np.full(n, noise_m**2)
    merges = merge_residuals(joint.landmarks, joint.landmark, number, off, joint.n_seen, variance)
    return segments, merges


def merge_residuals(
    landmarks: Ints, of: Ints, number: Ints, off: Floats, seen: Floats, variance: Floats
) -> MergeResiduals:
    """Compare the positions seen under each number that was merged into another.

    `landmarks` (m,); `of` (n,): index of the landmark of each row; `number` (n,): number under
    which it was seen; `off` (n, d), metres: deviation from the position of the landmark; `seen`
    (n,): number of observations; `variance` (n,), square metres: variance of a coordinate of one
    observation.
    """
    tracks, own = np.unique(number, return_inverse=True)
    landmark = np.zeros(len(tracks), dtype=np.int64)
    landmark[own] = of
    weighted = off * seen[:, None]
    own_seen, own_off = np.bincount(own, seen), sums_each(weighted, own, len(tracks))
    usual = np.bincount(own, seen * variance) / own_seen
    other_seen = np.bincount(of, seen, minlength=len(landmarks))[landmark] - own_seen
    other_off = sums_each(weighted, of, len(landmarks))[landmark] - own_off
    merged = np.flatnonzero((tracks != landmarks[landmark]) & (other_seen > 0))
    own_seen, other_seen = own_seen[merged], other_seen[merged]
    apart = own_off[merged] / own_seen[:, None] - other_off[merged] / other_seen[:, None]
    apart_m = np.linalg.norm(apart, axis=1)
    expected = np.sqrt(off.shape[1] * usual[merged] * (1 / own_seen + 1 / other_seen))
    residual = np.divide(apart_m, expected, out=np.zeros(len(apart)), where=expected > 0)
    return MergeResiduals(landmarks[landmark[merged]], tracks[merged], apart_m, residual)
