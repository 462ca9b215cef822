"""Mappers beside one another, in threads and in processes."""

from __future__ import annotations

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from relmap import PointMapper
from relmap.simulation import simulate_figure_eight
from tests.commands import run_process
from tests.worlds import refined, seen


def a_map(seed: int) -> str:
    log = simulate_figure_eight(seed=seed, iterations=60).log
    mapper = refined(PointMapper(), seen(log, known=False))
    return (mapper.map.positions.tobytes() + mapper.trajectory.tobytes()).hex()


@pytest.fixture(scope="module")
def alone() -> list[str]:
    return [a_map(seed) for seed in (1, 2)]


def test_two_threads_give_the_maps_of_one(alone: list[str]) -> None:
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(a_map, [1, 2])) == alone


def test_four_processes_give_the_maps_of_one(
    alone: list[str], child_env: dict[str, str], repo_root: Path
) -> None:
    # Forked by a process that has imported and loaded everything: anew each would take long.
    code = (
        "import json, multiprocessing\n"
        "from tests.test_side_by_side import a_map\n"
        "a_map(3)\n"
        "with multiprocessing.get_context('fork').Pool(4) as pool:\n"
        "    print(json.dumps(pool.map(a_map, [1, 2] * 2, chunksize=1)))\n"
    )
    done = run_process(
        [sys.executable, "-c", code], env=child_env | {"OMP_NUM_THREADS": "1"}, cwd=repo_root
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == alone * 2
