"""Joint evaluation of the motions of consecutive scans."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.planes.linking.hypotheses import LATER, MOST, Hypotheses, Judge
from relmap.planes.linking.judging import Candidates
from relmap.planes.linking.placement import Match
from relmap.planes.linking.tying import ACCEPTED
from relmap.planes.motions import after, distinct, inverse, motion_over, others
from relmap.planes.odometry.prediction import Expected

STEP = np.array([0.0, -0.5, 0.0])
FARTHER = np.array([0.0, -0.9, 0.0])


def candidates(*motions: Floats, evidence: float = 2.0) -> Candidates:
    n = len(motions)
    nothing = np.empty(0, dtype=np.int64)
    return Candidates(
        np.array(motions).reshape(-1, 3),
        np.full(n, evidence),
        np.ones(n, dtype=np.bool_),
        np.zeros(n, dtype=np.bool_),
        [Match(nothing, nothing, 1.0)] * n,
    )


def evidence_for(*right: Floats) -> Judge:
    """Return the evidence of two scans for a motion that is right only if it is one of these."""

    def judge(motion: Floats) -> tuple[float, float, bool]:
        stays = any(not others(motion[None], one)[0] for one in right)
        return (5.0, 0.0, True) if stays else (-np.inf, 0.2, False)

    return judge


def odds(run: Hypotheses, scan: int, motion: Floats) -> float:
    return run.verdict(scan).odds(motion)


def test_ambiguous_motions_are_resolved_by_the_previous_scan() -> None:
    """Two motions fit the last scan alike; from the scan before it only one of them does."""
    told = []
    for judge in (None, evidence_for(2 * STEP), evidence_for(STEP + FARTHER)):
        run = Hypotheses(STEP)
        run.go_on(candidates(STEP, FARTHER), STEP, judge)
        told.append(odds(run, 1, STEP))
    assert 0 < told[0] < ACCEPTED  # robots go on as before, but that is not enough
    assert told[1] > ACCEPTED
    assert told[2] < -1


def test_a_motion_contradicted_by_a_later_scan_is_rejected() -> None:
    run = Hypotheses(STEP)
    run.go_on(candidates(STEP, FARTHER), STEP, None)
    alone = odds(run, 1, STEP)
    run.go_on(candidates(STEP), STEP, evidence_for(FARTHER + STEP))
    assert odds(run, 1, STEP) < 0 < alone
    assert odds(run, 1, FARTHER) > 0


@pytest.mark.parametrize(("evidence", "breaks"), [(4.0, False), (-12.0, True)])
def test_a_break_is_likelier_than_little_evidence(evidence: float, breaks: bool) -> None:
    run = Hypotheses(STEP)
    run.go_on(candidates(STEP, evidence=evidence), STEP, None)
    assert (odds(run, 1, STEP) < 0) == breaks


def test_without_candidates_there_is_a_break() -> None:
    run = Hypotheses(STEP)
    for _ in range(3):
        run.go_on(candidates(), STEP, evidence_for())
    assert run.verdict(1).best is None
    assert odds(run, 1, STEP) < -10
    run.go_on(candidates(STEP), STEP, None)
    assert odds(run, 4, STEP) > 0


def test_shares_are_those_of_all_hypotheses_that_are_kept() -> None:
    rng = np.random.default_rng(0)
    run = Hypotheses(STEP)
    for _ in range(LATER + 3):
        motions = STEP + rng.normal(0, 1, (4, 3))
        run.go_on(candidates(*motions, evidence=0.0), STEP, None)
    verdict = run.verdict(LATER)
    assert len(verdict.share) == MOST
    assert verdict.share.sum() == pytest.approx(1)
    assert verdict.best is not None
    with pytest.raises(IndexError):
        run.verdict(LATER + 4)


def test_motions_follow_one_another() -> None:
    motions = np.random.default_rng(1).uniform(-2, 2, (5, 3))
    whole = motion_over(motions)
    for motion in motions[::-1]:
        whole = after(whole, inverse(motion)[None])[0]
    np.testing.assert_allclose(whole, np.zeros(3), atol=1e-12)


def test_distinct_motions_are_the_first_of_those_alike() -> None:
    motions = np.array([STEP, STEP + 0.01, FARTHER, STEP - 0.02, [2.0, 0.0, 0.0]])
    order = np.array([3, 0, 4, 1, 2])
    assert distinct(motions, order, 9).tolist() == [3, 4, 2]
    assert distinct(motions, order, 2).tolist() == [3, 4]


def test_a_motion_that_odometry_rules_out_is_not_a_rival() -> None:
    near, far = STEP, np.array([0.0, -1.5, 0.0])
    for expected, right in ((None, near), (Expected(far, 0.05, 0.02), far)):
        run = Hypotheses(near)
        run.go_on(candidates(near, far), near, None, expected)
        np.testing.assert_array_equal(run.verdict(1).best, right)
    assert odds(run, 1, far) > ACCEPTED
