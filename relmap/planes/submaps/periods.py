"""Steps that may be a period of the walls too short or too long: the usual step fits as well.

Links among them are replaced by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.adjoining import FINER, climbed
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.linking.placement import STILL
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import inverse
from relmap.planes.scans.beams import NEAR_M, Beams, compared, odds_over

AGREES, CONTRADICTS = 0.5, 0.02
"""Smallest fraction of the points in view that agree with a motion that is open, and largest that
contradict it. Log odds do not tell: a scan agrees best with one from the same place of the period,
as beams hit the same places again, and the true motion loses by up to 80."""
APART_M, NEARER = 0.3, 0.5
"""Distance from the usual step above which a step is examined, and from a step that of another one;
and distance of the other one from the usual step, as a fraction of that of the step."""
SOME = 100
"""Approximate number of steps from which the usual one is found."""
BACK_M = 0.1
"""Smallest step backwards: a robot at rest seems to move by less."""
REST_M = 0.03
"""A robot at rest seems to move by less."""
LEAST, SHARE = 3, 0.5
"""Minimum number of clear steps near the usual one, and fraction of those of a moving robot, which
may change its speed."""
STRETCH, SKIPPED = 3, 1
"""Minimum number of such links in a row, and maximum number of others in between; links that lead
backwards may be alone."""


def maybe_periods_off(scans: Scans, before: Ints, after: Ints, steps: Floats) -> Bools:
    """Return which steps (k, 3) from scans `before` (k,) to `after` (k,) may be others.

    Where walls repeat, all steps of a stretch may be taken for shorter ones, or for steps
    backwards, so that those around a step tell nothing. The usual step is that of the steps which
    no other motion that walls imply may replace, where an end of the pattern is in view; of the
    longer half of these, as a robot may rest often. A step unlike it may be another if small
    changes that beams prefer lead from the usual step to a motion closer to it, with which most
    points agree, and which hardly any contradict. If no step is without such a rival, those that
    lead backwards may be others that lead ahead.
    """
    clear_m = clear_steps(scans, before, after, steps)
    if len(clear_m):
        motions = usual_instead(scans, before, after, steps, usual_of(clear_m))
        return np.isfinite(motions[:, 0])
    pairs = zip(before.tolist(), after.tolist(), steps, strict=True)
    return np.array([_may_lead_ahead(scans, *pair) for pair in pairs], dtype=np.bool_)


def clear_steps(scans: Scans, before: Ints, after: Ints, steps: Floats) -> Floats:
    """Return the translations (c, 2), by scan, of those of some steps (k, 3) that are clear.

    No other motion that walls imply may replace them. About a hundred are examined.
    """
    some = slice(None, None, 1 + len(steps) // SOME)
    pairs = [*zip(before[some].tolist(), after[some].tolist(), steps[some], strict=True)]
    each_m = (steps / (after - before)[:, None])[some, 1:]
    return np.asarray(each_m[_clear(scans, pairs)])


def usual_of(clear_m: Floats) -> Floats:
    """Return the usual one (2,) of clear translations (c, 2)."""
    way_m = np.hypot(*clear_m.T)
    return np.asarray(np.median(clear_m[way_m >= np.median(way_m)], axis=0))


def usual_instead(
    scans: Scans, before: Ints, after: Ints, steps: Floats, usual_m: Floats
) -> Floats:
    """Return open motions (k, 3) near the usual one, (2,) by scan, instead of steps (k, 3).

    NaN for steps that are usual themselves, and where there is none; see `maybe_periods_off`.
    """
    motions, there_m = np.full(steps.shape, np.nan), (after - before)[:, None] * usual_m
    for k in np.flatnonzero(np.hypot(*(steps[:, 1:] - there_m).T) > APART_M).tolist():
        earlier, later = (scans.beams_of(i) for i in (int(before[k]), int(after[k])))
        found = _climbed_to(steps[k], there_m[k], earlier, later)
        motions[k] = np.nan if found is None else found
    return motions


def _climbed_to(step: Floats, usual_m: Floats, earlier: Beams, later: Beams) -> Floats | None:
    """Return the open motion (3,) near the usual one (2,) that beams prefer, if there is one."""
    motion, least_m = np.append(step[0], usual_m), NEARER * np.hypot(*(step[1:] - usual_m))
    for change_m in FINER:
        motion = climbed_by_beams(motion, change_m, earlier, later)
        if np.hypot(*(motion[1:] - usual_m)) >= least_m:
            return None
    return motion if _open(motion[None], earlier, later)[0] else None


def _clear(scans: Scans, pairs: Sequence[tuple[int, int, Floats]]) -> Bools:
    """Return which steps between scans, (k,), no other motion that walls imply may replace.

    None is open, nor is one as far from a step as another step is from one that is.
    """
    found = [_rivals(scans, *pair) for pair in pairs]
    apart = np.vstack([np.empty((0, 3)), *found])
    apart = np.vstack([apart, -apart]) * [0.0, 1.0, 1.0]
    clear = np.array([len(rivals) == 0 for rivals in found], dtype=np.bool_)
    for k in np.flatnonzero(clear).tolist():
        earlier, later = (scans.beams_of(i) for i in pairs[k][:2])
        clear[k] = not _open(pairs[k][2] + apart, earlier, later).any()
    return clear


def _may_lead_ahead(scans: Scans, before: int, after: int, step: Floats) -> bool:
    """Return whether a step (3,) leads backwards, and another that is open leads ahead."""
    if step[1] > -BACK_M:
        return False
    return bool((step[1] + _rivals(scans, before, after, step)[:, 1] > 0).any())


def _rivals(scans: Scans, before: int, after: int, step: Floats) -> Floats:
    """Return the changes (k, 3) of a step to other motions that walls imply, and that are open."""
    search = scans.search(before, after, STILL)
    if search is None:
        return np.empty((0, 3))
    changes = inverse(search.candidates([inverse(step)]).motions) - step
    changes = changes[np.hypot(*changes[:, 1:].T) > APART_M]
    is_open = _open(step + changes, scans.beams_of(before), scans.beams_of(after))
    return np.asarray(changes[is_open])


def _open(steps: Floats, earlier: Beams, later: Beams) -> Bools:
    """Return with which steps (k, 3) most points of two scans agree, and hardly any do not."""
    agree, contradict, undecided, _ = compared(later, earlier, steps, NEAR_M).T
    in_view = np.maximum(agree + contradict + undecided, 1.0)
    return np.asarray((agree >= AGREES * in_view) & (contradict <= CONTRADICTS * in_view))


def climbed_by_beams(step: Floats, change_m: float, earlier: Beams, later: Beams) -> Floats:
    """Return the step (3,) to which small changes lead that the beams of two scans prefer."""

    def gain(motions: Floats, motion: Floats) -> Floats:
        return odds_over([(later, earlier, np.vstack([motion, motions]))])[0]

    return climbed(step, [change_m], gain)


def periods_off(links: LinkRecord) -> dict[int, Floats]:
    """Return the motions (3,) into some scans that replace links a period off, by scan.

    A link is replaced if it differs from the usual step by more than 0.3 m, and a motion near that
    is open; see `maybe_periods_off`. Since it may be right if the robot changes its speed, that of
    the clear steps must be steady.
    """
    tied, scans = _compared(links), links.scans
    if not len(tied):
        return {}
    steps = inverse(links.motions[tied])
    clear_m = clear_steps(scans, tied - 1, tied, steps)
    if not _is_steady(clear_m):
        return {}
    usual_m = usual_of(clear_m)
    motions = usual_instead(scans, tied - 1, tied, steps, usual_m)
    off = np.hypot(*(motions[:, 1:] - usual_m).T) <= APART_M
    off &= (np.hypot(*steps[:, 1:].T) > REST_M) & ~np.isin(tied, [*links.instead])
    ahead_m = steps[off, 1:] @ usual_m / np.hypot(*usual_m)
    off[off] = _in_stretches(tied[off]) | (ahead_m < -BACK_M)
    return dict(zip(tied[off].tolist(), inverse(motions[off]), strict=True))


def _is_steady(clear_m: Floats) -> bool:
    """Return whether most clear translations (c, 2) of a moving robot are alike, and long."""
    if len(clear_m) < LEAST:
        return False
    usual_m, moving = usual_of(clear_m), np.hypot(*clear_m.T) > REST_M
    steady = moving & (np.hypot(*(clear_m - usual_m).T) < APART_M)
    is_long = bool(np.hypot(*usual_m) > APART_M)
    return is_long and bool(steady.sum() >= max(LEAST, SHARE * moving.sum()))


def _compared(links: LinkRecord) -> Ints:
    """Return the scans (k,) of a laser that are linked to the one before; none if steps are alike.

    Also none with odometry, and if further logs were added.
    """
    none = np.empty(0, dtype=np.int64)
    tied = 1 + np.flatnonzero((np.diff(links.submaps) == 0) & (links.submaps[1:] >= 0))
    if not len(tied) or len(links.wheels.given) or len(links.begun):
        return none
    if np.hypot(*np.ptp(inverse(links.motions[tied])[:, 1:], axis=0)) <= APART_M:
        return none
    beams = links.scans.beams_of
    shown = [min(len(beams(k - 1)), len(beams(k))) > 0 for k in tied.tolist()]
    return np.asarray(tied[np.array(shown, dtype=np.bool_)])


def _in_stretches(scans: Ints) -> Bools:
    """Return which scans (k,), ascending, are in a row of several."""
    row = np.cumsum(np.diff(scans, prepend=scans[:1]) > 1 + SKIPPED)
    return np.asarray(np.bincount(row)[row] >= STRETCH)
