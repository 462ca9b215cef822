"""The paper's pairwise recipe against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.order_kernels import medians, quantiles
from relmap.planes.pairwise import pairwise_map, relate
from relmap.planes.scans.observation import checked_planes
from relmap.planes.submaps.submap import stitched
from relmap.planes.walls.history import PlaneHistory
from tests.tables import poses_along
from tests.worlds import turn

FIRST = np.array([[4.0, -2.0], [4.0, 2.0]])
SECOND = np.array([[4.0, 2.0], [-1.0, 2.0]])


def in_robot_frame(ends: Floats, x: float, yaw: float) -> Floats:
    return np.asarray((ends - [x, 0.0]) @ turn(yaw))


def test_relation_does_not_depend_on_where_the_robot_is() -> None:
    """Figs 1 and 2: the first wall looks along -x, so its basis is turned by half a turn."""
    path = [(0.1 * k, 0.3 * k) for k in range(6)]
    first = np.array([in_robot_frame(FIRST, *at) for at in path])
    second = np.array([in_robot_frame(SECOND, *at) for at in path])
    relation = relate(first, second, (4.0, 5.0))
    np.testing.assert_allclose(relation.offset, [2.5, -2.0], atol=1e-12)
    np.testing.assert_allclose(relation.turn, np.pi / 2, atol=1e-12)
    assert relation.deviation < 1e-12
    assert relation.n == 6


def test_the_static_pair_of_ends_is_found() -> None:
    """Fig. 4: the right end of the first wall and the left end of the second one move."""
    first, second = np.repeat(FIRST[None], 8, axis=0), np.repeat(SECOND[None], 8, axis=0)
    first[:, 0, 1] += np.linspace(0.0, 1.0, 8)
    second[:, 1, 0] += np.linspace(0.0, 1.5, 8)
    relation = relate(first, second, (4.0, 5.0))
    assert relation.ends == (1, 0)
    np.testing.assert_allclose(relation.offset, [2.5, -2.0], atol=1e-12)


def test_chain_of_relations_is_exact_where_all_ends_are_seen() -> None:
    walls = np.array([FIRST, SECOND, [[-1.0, -2.0], [4.0, -2.0]]])
    scans = [[in_robot_frame(wall, 0.1 * k, 0.2 * k) for wall in walls] for k in range(6)]
    planes = SimpleNamespace(ends=np.concatenate(scans), end_type=np.full((18, 2), "corner"))
    seen = checked_planes(planes)
    when, plane = np.repeat(np.arange(6), 3), np.tile(np.arange(3), 6)
    rows = when, plane, seen.ends, seen.sd, seen.z_extent, np.full((18, 2), -1)
    history = PlaneHistory(*rows, np.zeros((6, 3)), np.zeros(6, dtype=np.int64))
    mapped = pairwise_map(history, 3)
    distances = np.linalg.norm(mapped.reshape(-1, 1, 2) - mapped.reshape(-1, 2), axis=2)
    truth = np.linalg.norm(walls.reshape(-1, 1, 2) - walls.reshape(-1, 2), axis=2)
    np.testing.assert_allclose(distances, truth, atol=1e-12)


def test_submaps_are_stitched_by_motions() -> None:
    poses = poses_along(np.arange(7))
    motions = np.zeros((7, 3))
    motions[:, 1] = -1.0
    first, second = np.full((7, 4, 4), np.nan), np.full((7, 4, 4), np.nan)
    first[1:3] = poses[1:3]
    shift = np.eye(4)
    shift[:2, 3] = 5.0, -2.0
    second[4:6] = shift @ poses[4:6]
    np.testing.assert_allclose(stitched([first, second], motions), poses, atol=1e-12)


def test_quantiles_of_sets_are_those_of_numpy() -> None:
    rng = np.random.default_rng(5)
    of, values = rng.permutation(np.repeat(np.arange(6), [1, 2, 3, 5, 8, 30])), rng.normal(size=49)
    for share in (0.0, 0.05, 0.75, 1.0):
        expected = [np.quantile(values[of == k], share) for k in range(6)]
        np.testing.assert_allclose(quantiles(of, values, share), expected)


def test_medians_of_sets() -> None:
    values = np.array([3.0, 1.0, 2.0, 9.0, 8.0])
    assert medians(np.array([0, 0, 0, 1, 1]), values).tolist() == [2.0, 8.0]
