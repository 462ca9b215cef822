"""Where walls repeat, steps that may be a period too short or too long are listed."""

from __future__ import annotations

import numpy as np
import pytest

import relmap.planes.remapping
from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes import PlaneMapper
from relmap.segmentation import PlaneSegmenter
from tests.segments import cast

PERIOD_M, LENGTH_M, RANGE_M = 1.6, 25.0, 8.0
BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, 361)


def niches() -> Floats:
    """Return the walls (w, 4) of a corridor with the same niches on both sides, metres."""
    walls = [[0.0, -1.2, 0.0, 1.2], [LENGTH_M, 1.2, LENGTH_M, -1.2]]
    for side in (-1.0, 1.0):
        line = [(0.0, 1.2)]
        for x in np.arange(3.0, LENGTH_M - 3.0, PERIOD_M).tolist():
            line += [(x, 1.2), (x, 1.6), (x + 0.8, 1.6), (x + 0.8, 1.2)]
        ends = np.array([*line, (LENGTH_M, 1.2)]) * [1.0, side]
        walls += np.hstack([ends[:-1], ends[1:]]).tolist()
    return np.array(walls)


def driven(along_m: Floats) -> PlaneMapper:
    """Return the refined map of a robot that was so far along the corridor at each scan."""
    mapper = PlaneMapper(segmenter=PlaneSegmenter(view_rad=np.pi, range_m=RANGE_M))
    walls, rng = niches().reshape(-1, 2, 2), np.random.default_rng(0)
    for x in along_m.tolist():
        ranges_m = np.array([cast(walls - [x, 0.0], bearing)[0] for bearing in BEARINGS])
        ranges_m += rng.normal(0.0, 0.02, len(ranges_m))
        points = ranges_m[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])
        mapper.update(points[ranges_m < RANGE_M])
    mapper.finish()
    mapper.refine()
    return mapper


def judged(mapper: PlaneMapper, along_m: Floats) -> tuple[Ints, Bools]:
    """Return the scans (k,) to which steps in submaps lead, and which are a period off."""
    scans, off = list[int](), list[bool]()
    for iterations, poses in mapper.paths:
        steps_m = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
        ahead = (np.linalg.inv(poses[:-1]) @ poses[1:])[:, 0, 3] > 0
        wrong_m = np.where(ahead, steps_m, -steps_m) - np.diff(along_m[iterations])
        scans += iterations[1:].tolist()
        off += (np.abs(wrong_m) > 0.3).tolist()
    return np.array(scans), np.array(off)


@pytest.fixture
def unmended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave such steps as they are."""
    monkeypatch.setattr(relmap.planes.remapping, "MENDED", 0)


@pytest.mark.usefixtures("unmended")
@pytest.mark.parametrize("step_m", [1.0, 1.15, 1.5])
def test_steps_a_period_off_are_listed(step_m: float) -> None:
    """In the middle, where no end is in view, all of them look the same, and are wrong alike."""
    along_m = np.arange(1.0, LENGTH_M - 1.0, step_m)
    mapper = driven(along_m)
    scans, wrong = judged(mapper, along_m)
    listed = np.isin(scans, mapper.weak_links)
    assert wrong.sum() >= 5
    assert listed[wrong].all()
    assert listed[~wrong].sum() <= 2


def test_steps_shorter_than_half_of_the_period_are_not_listed() -> None:
    along_m = np.arange(1.0, LENGTH_M - 1.0, 0.6)
    mapper = driven(along_m)
    assert not judged(mapper, along_m)[1].any()
    assert len(mapper.weak_links) == 0


@pytest.mark.parametrize(("step_m", "is_wrong"), [(0.6, False), (1.0, True), (1.2, True)])
def test_where_no_end_is_ever_in_view_steps_backwards_are_listed(
    step_m: float, is_wrong: bool
) -> None:
    along_m = np.arange(9.5, LENGTH_M - 9.5, step_m)
    mapper = driven(along_m)
    scans, wrong = judged(mapper, along_m)
    assert len(scans) > 0
    assert (wrong == is_wrong).all()
    assert (np.isin(scans, mapper.weak_links) == is_wrong).all()
