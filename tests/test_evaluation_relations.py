"""Errors against checked relations, of a robot that turns ever faster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.datasets import Relations
from relmap.datasets.scans import planar_poses
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.judged_path import AT_SCANS_S, relation_errors
from relmap.evaluation.truth import Truth
from tests.judged import make_result

STAMPS_S = np.arange(11.0)
OFF_RAD = 0.01


def poses_at(when: Floats) -> Floats:
    """Return poses at (2, 0) that turn by 0.1 t^2."""
    return planar_poses(np.full(len(when), 2.0), np.zeros(len(when)), 0.1 * when**2)


def relations(begin_s: Floats, end_s: Floats, off_rad: float = 0.0) -> Relations:
    """Return relations of the true path, turned by the error of the check."""
    none = np.zeros(len(end_s))
    off = planar_poses(none, none, none + off_rad)
    return Relations(begin_s, end_s, np.linalg.inv(poses_at(begin_s)) @ poses_at(end_s) @ off)


def test_relations_between_scans_have_the_error_of_interpolation() -> None:
    begin_s, end_s = np.array([0.0, 1.0, 2.0]), np.array([4.0, 5.5, 6.02])
    checked = (relations(begin_s, end_s, OFF_RAD),)
    errors = relation_errors(STAMPS_S, poses_at(STAMPS_S), checked)
    off_rad = 0.1 * np.array([0.0, 0.5 * 0.5, 0.02 * 0.98])  # of a chord of t^2
    assert errors.turn_rad == pytest.approx(np.abs(off_rad - OFF_RAD).mean(), abs=1e-12)
    assert errors.n == 3
    at_scans = relation_errors(STAMPS_S, poses_at(STAMPS_S), checked, AT_SCANS_S)
    assert at_scans.turn_rad == pytest.approx(np.abs(off_rad - OFF_RAD)[[0, 2]].mean(), abs=1e-12)
    assert at_scans.n == 2


@pytest.mark.parametrize("k", [1, 11])
def test_no_relation_at_the_scans(k: int) -> None:
    none = (relations(np.array([0.0, 3.5]), np.array([2.5, 20.0])),)
    assert relation_errors(STAMPS_S[:k], poses_at(STAMPS_S[:k]), none, AT_SCANS_S) is None
    assert relation_errors(STAMPS_S[:k], poses_at(STAMPS_S[:k]), (), AT_SCANS_S) is None


def test_the_clock_of_most_relations_decides() -> None:
    begin_s, end_s = np.array([0.0, 1.0]), np.array([4.0, 5.0])
    wrong = Relations(begin_s + 8.0, end_s + 8.0, relations(begin_s, end_s).T_begin_end)
    errors = relation_errors(STAMPS_S, poses_at(STAMPS_S), (wrong, relations(begin_s, end_s)))
    assert errors.n == 2
    assert errors.turn_rad == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("end_s", "note"),
    [
        (4.0, None),
        (4.5, "0 of 1 checked relations have both ends within 0.03 s of scans;"),
        (
            (4.0, 4.5),
            "1 of 2 checked relations have both ends within 0.03 s of scans: 0.000 m, 0.0100 rad",
        ),
        (20.0, "no checked relation lies within the times of the result"),
    ],
)
def test_notes_say_how_many_relations_lie_at_scans(
    end_s: float | tuple[float, ...], note: str | None
) -> None:
    end = np.atleast_1d(end_s)
    result = replace(make_result(), stamps_s=STAMPS_S, poses=poses_at(STAMPS_S))
    notes = evaluate(result, Truth(relations=(relations(0 * end, end, OFF_RAD),))).notes
    said = [one for one in notes if "relation" in one]
    assert len(said) == (note is not None)
    assert note is None or note in said[0]
