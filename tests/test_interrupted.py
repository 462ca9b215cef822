"""Updates that are interrupted, and threads that share a mapper."""

from __future__ import annotations

import copy
import importlib
import operator
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap import MapperConfig, Plane3dMapper, PlaneMapper, PointMapper, RelmapError
from relmap.io.journal import writing
from relmap.simulation import simulate_building
from tests.commands import run_process
from tests.interrupting import interrupted
from tests.worlds import walk

AnyMapper = PointMapper | PlaneMapper
Kind = type[PointMapper] | type[PlaneMapper]

POINTS = [points for _, points in walk(3, 5, 0.02, iterations=30).scans]
WALLS = [scan.seen for scan in simulate_building(seed=0, points=20, iterations=25).scans]
SIDES = np.concatenate(
    [np.insert(np.argwhere(np.ones((40, 40))) / 20, axis, 1.5, axis=1) for axis in range(3)]
)
KINDS = [(PointMapper, POINTS), (PlaneMapper, WALLS)]


def told(mapper: AnyMapper) -> bytes:
    mapper.finish()
    return mapper.map.positions.tobytes() + mapper.trajectory.tobytes()


def go_on(mapper: Any, scans: Sequence[Any]) -> Any:
    for scan in scans[mapper.n_iterations :]:
        mapper.update(scan)
    return mapper


def is_whole(mapper: AnyMapper) -> bool:
    """Return whether a mapper does not say that it was interrupted."""
    try:
        mapper.flush()
    except RelmapError:
        return False
    return True


@pytest.mark.parametrize(("kind", "scans"), KINDS)
def test_an_interrupted_update_is_undone_or_complete_or_reported(
    kind: Kind, scans: Sequence[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "INTERVAL_S", 0.0)
    whole, k = told(go_on(kind(), scans)), len(scans) - 8
    twin = go_on(kind(journal=tmp_path / "twin"), scans[:k])
    length = interrupted(lambda: twin.update(scans[k]))
    was_told = False
    for trial, at in enumerate(np.linspace(1, length, 8).astype(int).tolist()):
        path = tmp_path / f"{trial}.journal"
        mapper = go_on(kind(journal=path), scans[:k])
        interrupted(lambda m=mapper: m.update(scans[k]), at)  # type: ignore[misc]
        if is_whole(mapper):
            assert told(go_on(mapper, scans)) == whole
            continue
        was_told = True
        for look in ("map", "landmarks", "trajectory", "n_iterations"):
            with pytest.raises(RelmapError, match="interrupted"):
                getattr(mapper, look)
        with pytest.raises(RelmapError, match="interrupted"):
            mapper.save(tmp_path / "mapper.npz")
        mapper.close()
        resumed = kind.resume(path)
        assert resumed.n_iterations in (k, k + 1)
        assert told(go_on(resumed, scans)) == whole
    assert was_told


def test_every_mapper_reports_interrupts_or_continues_to_the_same_map(
    child_env: dict[str, str], repo_root: Path
) -> None:
    kinds = ["points-odometry", "walls-onto", "planes3d"]
    done = run_process(
        [sys.executable, "-m", "tests.interrupting", "--every", "1500", *kinds],
        env=child_env | {"OMP_NUM_THREADS": "1"},
        cwd=repo_root,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("'reported': ") == len(kinds)


def test_interrupted_updates_are_reported_but_refused_ones_are_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mapper = go_on(PointMapper(), POINTS[:20])
    mapper.refine()
    refined = len(mapper.refined)
    assert refined
    with pytest.raises(RelmapError, match="ids did not come with"):
        mapper.update(POINTS[20], ids=np.arange(len(POINTS[20])))
    assert len(mapper.refined) == refined
    monkeypatch.setattr(type(mapper.engine.schedule), "see", None)
    with pytest.raises(TypeError):
        mapper.update(POINTS[20])
    monkeypatch.undo()
    for each in (mapper, copy.deepcopy(mapper)):
        with pytest.raises(RelmapError, match="interrupted"):
            each.update(POINTS[20])
        with pytest.raises(RelmapError, match="interrupted"):
            each.finish()


def test_a_flush_that_is_interrupted_loses_nothing(tmp_path: Path) -> None:
    length = interrupted(go_on(PointMapper(journal=tmp_path / "x"), POINTS[:4]).flush)
    for at in range(length // 2, length, length // 25):
        path = tmp_path / f"{at}.journal"
        mapper = go_on(PointMapper(journal=path), POINTS[:4])
        interrupted(mapper.flush, at)
        mapper.close()
        assert PointMapper.resume(path).n_iterations == 4


class Waiting:
    """A segmenter that waits in the midst of a scan until it is released."""

    def __init__(self) -> None:
        self.begun, self.may_end = threading.Event(), threading.Event()

    def fit(self, points: Any) -> None:
        self.begun.set()
        self.may_end.wait()
        self.planes_ = WALLS[0]


def test_two_threads_that_share_a_mapper_are_refused() -> None:
    segmenter = Waiting()
    mapper = PlaneMapper(MapperConfig(), segmenter)
    other = threading.Thread(target=mapper.update, args=([[1.0, 2.0]],))
    other.start()
    segmenter.begun.wait()
    for use in (lambda: mapper.update(WALLS[0]), mapper.finish, lambda: mapper.n_iterations):
        with pytest.raises(RelmapError, match="another thread is updating this mapper"):
            use()
    segmenter.may_end.set()
    other.join()
    assert mapper.n_iterations == 1


@pytest.mark.parametrize(
    ("mapper", "scan", "where"),
    [
        (PointMapper(), POINTS[0], "relmap.core.readout.landmark_map"),
        (PlaneMapper(), WALLS[0], "relmap.planes.mapped.corner_map"),
        (Plane3dMapper(), SIDES, "relmap.planes3d.mapped.plane_table"),
    ],
    ids=["points", "walls", "planes3d"],
)
def test_what_another_thread_changes_while_it_is_read_is_not_returned(
    mapper: Any, scan: Any, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = operator.attrgetter("planes" if isinstance(mapper, Plane3dMapper) else "map")
    mapper.update(scan)
    module, name = where.rsplit(".", 1)
    whole = getattr(importlib.import_module(module), name)

    def interleaved(*given: object) -> Any:
        other = threading.Thread(target=mapper.update, args=(scan,))
        other.start()
        other.join()
        return whole(*given)

    monkeypatch.setattr(where, interleaved)
    with pytest.raises(RelmapError, match="another thread is updating this mapper"):
        read(mapper)
    monkeypatch.undo()
    read(mapper)
    assert mapper.n_iterations == 2


def test_scans_are_localised_in_the_map_as_it_is_while_a_run_is_resumed(tmp_path: Path) -> None:
    mapper = go_on(PlaneMapper(journal=tmp_path / "journal"), WALLS)
    mapper.close()
    steps = np.linspace(0.0, 1.0, 20)[:, None]
    beams = np.concatenate([right + steps * (left - right) for right, left in WALLS[20].ends])
    places: list[int] = []

    def localise(resumed: PlaneMapper) -> None:
        places.append(resumed.locate(WALLS[20], beams).n_places)

    PlaneMapper.resume(tmp_path / "journal", localise)
    assert places[0] == 0
    assert places[-1] == mapper.locate(WALLS[20], beams).n_places > 0
