"""Own association in worlds that are hard to associate: the map against batch least squares.

    python benchmarks/worlds.py [--only NAME[,NAME]] [--seeds N] [--covariances]

Each line is a world and a seed: the landmark RMSE of all submaps, each aligned separately,
relative to that of unweighted batch least squares over all observations with the true ids; that of
the worst submap of ten landmarks, relative to least squares over the observations of its landmarks
in its scans; landmarks per true one; purity, and that of an oracle, which assigns each scan to the
true landmarks from the true pose and covariances and so is about the limit; the fraction of the
landmarks seen ten times that is mapped, in all submaps and in the largest; submaps of ten
landmarks.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.optimize import linear_sum_assignment
from shared.tables import header, row

from relmap import PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid
from relmap.evaluation.metrics import majority_ids, purity
from relmap.simulation import World, WorldSpec, simulate_world

FEWEST = 10
"""Minimum number of landmarks of an evaluated submap."""
FIELD = {"kind": "field", "length_m": 540.0}
WORLDS: dict[str, dict[str, object]] = {
    "streets": {},
    "streets-space": {"space": True},
    "long-streets": {"length_m": 1200.0, "iterations": 800},
    "corridor": {"kind": "corridor", "length_m": 800.0},
    "ring": {"kind": "ring", "length_m": 1000.0, "iterations": 600},
    "field": FIELD,
    "line": {"kind": "line", "length_m": 300.0, "iterations": 300, "spacing_m": 2.0},
    "plane": {**FIELD, "kind": "plane"},
    "clumps": {**FIELD, "kind": "clumps"},
    "columns": {**FIELD, "kind": "columns"},
    "stairs": {"kind": "stairs", "length_m": 100.0, "iterations": 300},
    "noise-.1": {**FIELD, "sigma": 0.2},
    "noise-.2": {**FIELD, "sigma": 0.4},
    "noise-.3": {**FIELD, "sigma": 0.6},
    "range-noise": {"noise": "range"},
    "bearing-noise": {"noise": "bearing"},
    "growing-noise": {"noise": "growing", "sigma": 0.1},
    "stereo": {"noise": "stereo", "sigma": 0.03, "space": True},
    "missed": {"missed": 0.3},
    "missed-spurious": {"missed": 0.3, "spurious": 0.1},
    "missed-space": {"missed": 0.3, "spurious": 0.1, "space": True},
    "turns-20": {**FIELD, "turn_deg": 20.0},
    "turns-40": {**FIELD, "turn_deg": 40.0},
    "turns-60": {**FIELD, "turn_deg": 60.0},
    "turns-60-round": {**FIELD, "turn_deg": 60.0, "view_deg": 360.0},
    "sparse": {"spacing_m": 7.0},
}


def least_squares(world: World, used: Bools) -> dict[int, Floats]:
    """Return the landmark positions of batch least squares over the rows used, by true id."""
    points, d = world.log.points_robot, world.log.points_robot.shape[1]
    for _ in range(20):
        seen = np.bincount(world.true_ids[used], minlength=len(world.landmark_ids))
        scans = np.bincount(world.log.iteration[used], minlength=len(world.log))
        kept = used & (seen[world.true_ids] > 1) & (scans[world.log.iteration] > d)
        if kept.sum() == used.sum():
            break
        used = kept
    ids, landmark = np.unique(world.true_ids[used], return_inverse=True)
    pose = np.unique(world.log.iteration[used], return_inverse=True)[1]
    try:
        batch = Batch(points[used], pose, landmark)
        found = batch_least_squares(batch, world.landmarks_map[ids, :d], iterations=1000)
    except RelmapError:
        return {}
    return dict(zip(ids.tolist(), found, strict=True))


def rows_within(world: World, landmarks: Ints, ids: Ints, own: Ints) -> Bools:
    """Return which rows show true ids of a submap, in scans that show two of its landmarks.

    `landmarks` (n,): landmark of each row; `ids` and `own`: true ids and landmarks of the submap.
    """
    scans, counts = np.unique(world.log.iteration[np.isin(landmarks, own)], return_counts=True)
    within = np.isin(world.log.iteration, scans[counts > 1])
    return np.asarray(within & np.isin(world.true_ids, ids))


def squares(positions: Floats, truth: Floats) -> Floats:
    """Return the squared errors (n,) after rigid alignment."""
    R, t = fit_rigid(positions, truth)
    return np.asarray(np.sum((positions @ R.T + t - truth) ** 2, axis=1))


def compared(positions: Floats, ids: Ints, limit: dict[int, Floats], truth: Floats) -> Floats:
    """Return the squared errors (n, 2) of landmarks with true ids, and those of least squares."""
    known = np.array([row in limit for row in ids.tolist()], dtype=bool)
    if known.sum() < FEWEST:
        return np.empty((0, 2))
    best = np.array([limit[row] for row in ids[known].tolist()])
    there = truth[ids[known], : best.shape[1]]
    both = positions[known, : best.shape[1]], best
    return np.column_stack([squares(each, there) for each in both])


def ratio(squared: Floats) -> float:
    """Return the ratio of the RMSE; NaN if least squares did not converge."""
    mine, best = np.sqrt(squared.sum(axis=0))
    return float(mine / best) if len(squared) else np.nan


def oracle_purity(world: World) -> float:
    """Return the purity of the best assignment to the true landmarks from the true poses."""
    d, scans = world.log.points_robot.shape[1], world.log.iteration
    n_right = 0
    for iteration, T in enumerate(world.trajectory):
        rows = np.flatnonzero((scans == iteration) & (world.true_ids >= 0))
        if not len(rows):
            continue
        there = ((world.landmarks_map - T[:3, 3]) @ T[:3, :3])[:, :d]
        off = world.log.points_robot[rows][:, None] - there
        information = np.linalg.inv(world.covariances[rows])
        row, landmark = linear_sum_assignment(np.einsum("nmi,nij,nmj->nm", off, information, off))
        n_right += np.sum(world.landmark_ids[landmark] == world.true_ids[rows[row]])
    return float(n_right / np.sum(world.true_ids >= 0))


def judge(world: World, with_covariances: bool) -> dict[str, float]:
    """Map a world without ids and evaluate the map."""
    truth, limit = world.landmarks_map, least_squares(world, world.true_ids >= 0)
    mapper = PointMapper()
    ends = np.cumsum([len(scan.points_robot) for scan in world.log.scans()])
    noise = np.split(world.covariances, ends[:-1]) if with_covariances else [None] * len(ends)
    labels = np.concatenate(
        [
            mapper.update(scan.points_robot, covariances=covariances)
            for scan, covariances in zip(world.log.scans(), noise, strict=True)
        ]
    )
    mapper.finish()
    mapper.refine()
    now = mapper.landmarks_of(labels)
    stands_for = dict(
        zip(*(a.tolist() for a in majority_ids(now, world.true_ids)[:2]), strict=True)
    )
    all_ids: list[int] = []
    every, ratios, largest = [], [], 0
    often = np.flatnonzero(np.bincount(world.true_ids[world.true_ids >= 0]) >= FEWEST)
    for rank, submap in enumerate(mapper.submaps):
        own = [label in stands_for for label in submap.landmark_ids.tolist()]
        ids = np.array([stands_for[label] for label in submap.landmark_ids[own].tolist()])
        all_ids += ids.tolist()
        largest = len(np.intersect1d(ids, often)) if rank == 0 else largest
        found = compared(submap.positions[own], ids, limit, truth)
        if len(found) < FEWEST:
            continue
        every.append(found)
        within = least_squares(world, rows_within(world, now, ids, submap.landmark_ids))
        ratios.append(ratio(compared(submap.positions[own], ids, within, truth)))
    mapped = np.intersect1d(all_ids, often)
    return {
        "ratio": ratio(np.concatenate(every)) if every else np.nan,
        "worst": float(np.max(ratios)) if ratios else np.nan,
        "per true": len(all_ids) / max(len(set(all_ids)), 1),
        "purity": purity(now, world.true_ids) or np.nan,
        "oracle": oracle_purity(world),
        "mapped": len(mapped) / len(often),
        "largest": largest / len(often),
        "submaps": len(ratios),
    }


def main() -> None:
    """Print a line for each world and seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="names, separated by commas", default=",".join(WORLDS))
    parser.add_argument("--seeds", default="0,1,2,3,4")
    parser.add_argument("--covariances", action="store_true", help="pass the noise to the mapper")
    given = parser.parse_args()
    names = ("ratio", "worst", "per true", "purity", "oracle", "mapped", "largest", "submaps")
    header("world", "seed", *names)
    for name in given.only.split(","):
        for seed in map(int, given.seeds.split(",")):
            spec = WorldSpec(**WORLDS[name], seed=seed)  # type: ignore[arg-type]
            found = judge(simulate_world(spec), given.covariances)
            places = {"purity": 4, "oracle": 4, "submaps": 0}
            row(name, seed, *(f"{found[key]:.{places.get(key, 2)}f}" for key in names))


if __name__ == "__main__":
    main()
