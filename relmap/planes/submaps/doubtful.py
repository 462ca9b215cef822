"""Steps from scan to scan that the scans do not determine: weak links, and links that are cut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.linking.placement import STILL
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import from_matrices, inverse, wrapped
from relmap.planes.odometry.prediction import OTHERWISE
from relmap.planes.odometry.steps import corrected
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.scans.beams import Beams, odds_over
from relmap.planes.submaps.periods import NEARER, climbed_by_beams, maybe_periods_off
from relmap.planes.submaps.submap import WallSubmap, between_logs
from relmap.planes.walls.history import PlaneHistory

FREE_M = 0.3
"""Distance at which beams must exclude another motion."""
BOTH_M = np.array([[-FREE_M], [FREE_M]])
EXCLUDED, CLEARLY = 3.0, 20.0
"""Log odds by which they must, and where the walls in common leave a direction open: there the
motion model or another match gave the step. In 30 short-sighted logs, with 5 for both, 25 wrong
steps more are not listed, and 53 right ones of 15,000 fewer are."""
LEAST_SHARE = 0.01
"""Fraction of the points that must agree better with the step: the log odds take the points for
independent, and many tiny differences along a bare corridor are not."""
UNUSUAL_M, BESIDE = 0.3, 4
"""Difference between a link and those around it above which it is evaluated again, and how many on
either side these are."""
UNUSUAL_RAD = np.deg2rad(30.0)
"""Difference from the turns around it above which a turn is unusual."""
GAP = 3
"""How many scans apart two scans may be to search motions nearer to the usual ones."""
CHANGE_M, AWAY_M = 0.1, 0.25
"""Size of the changes by which beams may improve a step, and distance beyond which it is listed; so
is one as far from odometry."""
USUALLY, LEAP, LEAP_M = 0.9, 3.0, 0.5
"""A step is listed that is longer than so many times this quantile of all steps, and this length: a
robot carried to a place that looks like another."""
LOOSE = np.diag([1e-3, 1e-4, 1e-4])
"""Information that keeps directions finite that no wall determines: rotation, x, y; as of so many
metres of wall."""


def undetermined_steps(
    submaps: Sequence[WallSubmap], history: PlaneHistory, links: LinkRecord
) -> Ints:
    """Return the iterations (k,) whose motion since the previous one is not determined, ascending.

    Short walls far away, such as an arc at the end of the range, leave a motion open that turns the
    robot about them. So a step is moved by 0.3 m in the direction that the walls in common
    determine least, and turned as they allow. It is also replaced by the usual steps of the four
    before and of the four after it, if they differ, and by motions nearer to these, or that turn
    more as these do, that the walls of both scans imply. It is determined if the beams of both
    scans exclude all of these, neither shows one wall only, and, if few common walls cross, no
    small changes that the beams prefer lead away from it, one after the other. A step that may be a
    period of the walls off, or was (`maybe_periods_off`), is listed, too, one far longer than the
    others, and an unusual one to or from a scan that repeats the one before it, point by point: the
    sensor did not measure anew. Where a submap continues after scans that are not part of it, the
    motion is since the last one that is. Without beams, and with odometry,
    the walls decide (`PlaneHistory.weak_links`); steps that contradict odometry are listed, too, of
    those that walls measured only if they are as long. From one log to the next there is no step:
    the place of a log in the map is determined by a stretch of it.
    """
    if _have_odometry(links):
        against = _against_odometry(submaps, links)
        weak_links = np.union1d(history.weak_links, [*against, *links.instead])
        return np.setdiff1d(weak_links.astype(np.int64), links.begun)
    weak = np.zeros(history.n_iterations, dtype=np.bool_)
    weak[history.weak_links] = True
    free, least = free_directions(history), np.where(weak, CLEARLY, EXCLUDED)
    scans = links.scans
    before, after, steps = _steps(submaps)
    gap = (after - before)[:, None]
    to_usual = _around(steps / gap) * gap - steps
    each = zip(before.tolist(), after.tolist(), steps, to_usual.swapaxes(0, 1), strict=True)
    shown = np.zeros(len(after), dtype=np.bool_)
    for k, (first, scan, step, ways) in enumerate(each):
        earlier, later = (scans.beams_of(i) for i in (first, scan))
        if len(earlier) and len(later):
            one_wall = earlier.on_one_wall or later.on_one_wall
            rivals = _rivals(scans, (first, scan), step, free[scan], ways)
            excluded = _excluded(step, rivals, earlier, later)
            weak[scan] = one_wall or excluded < least[scan]
            if history.hardly_crossed[scan] and not weak[scan]:
                weak[scan] = _leads_away(step, earlier, later)
            shown[k] = not weak[scan]
    weak[after[shown]] = maybe_periods_off(scans, before[shown], after[shown], steps[shown])
    weak[after[np.isin(after, [*links.instead])]] = True
    weak[after[_leap(steps / gap) | _stale(links.beams, before, after, to_usual)]] = True
    weak[after[between_logs(links.begun, before, after)]] = False
    return np.flatnonzero(weak)


def _steps(submaps: Sequence[WallSubmap]) -> tuple[Ints, Ints, Floats]:
    """Return the steps (k, 3) within submaps, and the scans (k,), (k,) before and after, ascending.

    A step is the pose of the later scan in the frame of the earlier one: yaw, x, y.
    """
    found, steps = [np.empty((2, 0), dtype=np.int64)], [np.empty((0, 3))]
    for submap in submaps:
        rows = submap.known
        found.append(submap.first_iteration + np.array([rows[:-1], rows[1:]]))
        T = np.linalg.inv(submap.poses[rows[:-1]]) @ submap.poses[rows[1:]]
        steps.append(from_matrices(T))
    (before, after), every = np.concatenate(found, axis=1), np.concatenate(steps)
    order = np.argsort(after, kind="stable")
    return before[order], after[order], every[order]


def _leap(steps: Floats) -> Bools:
    """Return which steps (k, 3) are far longer than the others."""
    if not len(steps):
        return np.empty(0, dtype=np.bool_)
    way_m = np.hypot(*steps[:, 1:].T)
    return np.asarray(way_m > LEAP * np.quantile(way_m, USUALLY) + LEAP_M)


def _stale(beams: BeamStore, before: Ints, after: Ints, to_usual: Floats) -> Bools:
    """Return which unusual steps lead to or from a scan that repeats the one before it.

    `to_usual` (2, k, 3): changes that make them the usual steps before and after them.
    """
    pairs = zip(before.tolist(), after.tolist(), strict=True)
    points = ((beams.given(a).points, beams.given(b).points) for a, b in pairs)
    repeats = np.array([len(a) > 0 and np.array_equal(a, b) for a, b in points], dtype=np.bool_)
    repeats |= np.isin(before, after[repeats])
    return np.asarray(repeats & np.any(_unlike(to_usual), axis=(0, 1)))


def _unlike(to_usual: Floats) -> tuple[Bools, Bools]:
    """Return whether changes (..., 3) that make steps usual move the robot far, or turn it."""
    far = np.hypot(to_usual[..., 1], to_usual[..., 2]) > FREE_M
    return far, np.abs(wrapped(to_usual[..., 0])) > UNUSUAL_RAD


def _against_odometry(submaps: Sequence[WallSubmap], links: LinkRecord) -> Ints:
    """Return the scans (k,) into which the step of the map contradicts odometry, but no link does.

    Where walls measured another motion than odometry, odometry is rejected and reported. But if
    that is far longer than the other steps, the robot may have been carried elsewhere.
    """
    wheels, motions, measured = links.wheels, links.motions, links.measured
    noise = wheels.noise_over_all(motions, measured)
    assert noise is not None
    before, after, steps = _steps(submaps)
    kept = (after == before + 1) & (_leap(steps) | ~wheels.left_out(motions, measured)[after])
    given = wheels.given.over(len(motions))[after]
    kept &= np.isfinite(given[:, 0, 0])
    after, steps, given = after[kept], steps[kept], given[kept]
    off, (sd_m, _) = corrected(noise, given) - steps, noise.sigmas(given)
    off_m = np.hypot(off[:, 1], off[:, 2])
    return np.asarray(after[(off_m > AWAY_M) & (off_m > OTHERWISE * sd_m)])


def _around(moved: Floats) -> Floats:
    """Return the medians (2, k, n) of the motions (k, n) before each, and after each."""
    if not len(moved):
        return np.empty((2, *moved.shape))
    padded = np.pad(moved, [(BESIDE, BESIDE), (0, 0)], "edge")
    medians = np.median(sliding_window_view(padded, BESIDE, axis=0), axis=-1)
    return np.stack([medians[: len(moved)], medians[BESIDE + 1 :]])


def unsupported_links(history: PlaneHistory, links: LinkRecord) -> Ints:
    """Return the iterations (k,) into which a link is unlike those around it, and may be another.

    It differs from their median by more than 0.3 m, and the beams prefer one that is 0.3 m off in
    the direction that walls determine least, or the usual step before or after it. Links by maps
    and by odometry are left as they are.
    """
    if _have_odometry(links):
        return np.empty(0, dtype=np.int64)
    tied = 1 + np.flatnonzero((np.diff(history.submap) == 0) & (history.submap[1:] >= 0))
    free, scans, found = free_directions(history), links.scans, list[int]()
    steps = inverse(history.motion[tied])
    to_usual = ((_around(steps) - steps) * [0.0, 1.0, 1.0]).swapaxes(0, 1)  # turns may be right
    for k in np.flatnonzero(_unusual(tied, history) & ~np.isinf(links.evidence[tied])).tolist():
        scan, step = int(tied[k]), steps[k]
        earlier, later = (scans.beams_of(i) for i in (scan - 1, scan))
        if len(earlier) and len(later):
            rivals = _rivals(scans, (scan - 1, scan), step, free[scan], to_usual[k])
            found += [scan] * (_excluded(step, rivals, earlier, later) < 0)
    return np.array(found, dtype=np.int64)


def _unusual(tied: Ints, history: PlaneHistory) -> Bools:
    """Return which links into scans (k,), ascending, differ from those around them."""
    near = tied[:, None] + [*range(-BESIDE, 0), *range(1, BESIDE + 1)]
    known = np.isin(near, tied)
    near = np.where(known, near, 0)
    known &= history.submap[near] == history.submap[tied][:, None]
    moved = np.sort(np.where(known[..., None], history.motion[near, 1:], np.inf), axis=1)
    n = known.sum(axis=1)
    row, middle = np.flatnonzero(n), n[n > 0]
    usual = (moved[row, (middle - 1) // 2] + moved[row, middle // 2]) / 2
    unusual = np.zeros(len(tied), dtype=np.bool_)
    unusual[row] = np.hypot(*(history.motion[tied[row], 1:] - usual).T) > UNUSUAL_M
    return unusual


def _have_odometry(links: LinkRecord) -> bool:
    return links.wheels.noise_over_all(links.motions, links.measured) is not None


def _rivals(
    scans: Scans, pair: tuple[int, int], step: Floats, free: Floats, to_usual: Floats
) -> Floats:
    """Return the changes (k, 3) of the step (3,) of two scans that beams must exclude.

    `free`, `to_usual`: as for `_changes`.
    """
    fitted = _fitted(scans, *pair, step, to_usual)
    return np.vstack([_changes(step, free, to_usual), fitted])


def _changes(step: Floats, free: Floats, to_usual: Floats) -> Floats:
    """Return changes (k, 3) of a step (3,), by 0.3 m and to the usual ones; its rotation stays.

    `free` (3,): the direction that walls determine least; `to_usual` (2, 3): changes that make it
    the usual step before or after it.
    """
    far = np.hypot(*to_usual[:, 1:].T) > FREE_M
    (turn, x, y), c, s = free, np.cos(step[0]), np.sin(step[0])
    way = np.array([turn, c * x - s * y, s * x + c * y])  # in the frame of the earlier scan
    return np.vstack([BOTH_M * way, to_usual[far] * [0.0, 1.0, 1.0]])


def _fitted(scans: Scans, earlier: int, later: int, step: Floats, to_usual: Floats) -> Floats:
    """Return the changes (k, 3) of an unusual step (3,) to motions nearer to the usual ones.

    The walls of both scans imply them: where walls repeat, robots do not move by just the usual
    step, and rooms may look the same from several sides. `to_usual` as in `_changes`.
    """
    turn, way = wrapped(to_usual[:, :1]), to_usual[:, 1:]
    far, turned = _unlike(to_usual)
    near = (far.any() or turned.any()) and later - earlier <= GAP
    search = scans.search(earlier, later, STILL) if near else None
    if search is None:
        return np.empty((0, 3))
    usual = np.zeros((4, 3))
    usual[:2, 1:], usual[2:, :1] = way, turn
    usual = step + usual[np.append(far, turned)]
    found = search.candidates([*inverse(usual)])
    changes = inverse(found.motions) - step
    off = np.full((2, 2, len(changes)), np.inf)
    off[0, far] = np.linalg.norm(changes[:, 1:] - way[far, None], axis=2)
    off[1, turned] = np.abs(wrapped(changes[:, 0] - turn[turned]))
    least = [np.hypot(*way[far].T).min(initial=np.inf), np.abs(turn[turned]).min(initial=np.inf)]
    nearer = off.min(axis=1) < NEARER * np.array(least)[:, None]
    nearer[1] &= ~found.doubtful
    return np.asarray(changes[nearer.any(axis=0)])


def _excluded(step: Floats, changes: Floats, earlier: Beams, later: Beams) -> float:
    """Return the log odds by which beams exclude all changes (k, 3) of a step (3,).

    `step`: pose of the later scan in the frame of the earlier one: yaw, x, y.
    """
    odds, share = odds_over([(later, earlier, np.vstack([step, step + changes]))])
    excluded, clear = -float(odds.max()), share.max() < -LEAST_SHARE
    return excluded if clear else min(excluded, 0.0)


def _leads_away(step: Floats, earlier: Beams, later: Beams) -> bool:
    """Return whether small changes that beams prefer lead away from a step (3,)."""
    off = climbed_by_beams(step, CHANGE_M, earlier, later) - step
    return bool(np.hypot(*off[1:]) > AWAY_M)


def free_directions(history: PlaneHistory) -> Floats:
    """Return the motion of each scan (i, 3) that walls determine least: rotation, x, y.

    By the walls in common with the scan before, or all if there are none. The translation is 1 m.
    """
    own = history.in_common
    own |= ~np.isin(history.iteration, history.iteration[own])
    begin, end = history.ends[own].transpose(1, 0, 2)
    length = np.maximum(np.linalg.norm(end - begin, axis=1), 1e-9)
    x, y = ((begin + end) / 2).T
    nx, ny = (begin - end)[:, 1] / length, (end - begin)[:, 0] / length
    by = np.column_stack([ny * x - nx * y, nx, ny])
    each = length[:, None, None] * by[:, :, None] * by[:, None]
    each[:, 0, 0] += length**3 / 12
    information = np.tile(LOOSE, (history.n_iterations, 1, 1))
    np.add.at(information, history.iteration[own], each)
    covariance = np.linalg.inv(information)
    least = np.linalg.eigh(covariance[:, 1:, 1:])[1][..., -1]
    free = np.einsum("kij,kj->ki", covariance[..., 1:], least)
    return np.asarray(free / np.linalg.norm(free[:, 1:], axis=1, keepdims=True))
