"""How accurate the map of walls is: simulated buildings, and real laser logs.

    python benchmarks/planes.py [DATA] [--seeds 5]

prints tables in markdown; DATA is a folder of the real data sets.
"""

from __future__ import annotations

import argparse
import gzip
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from relmap import PlaneMapper
from relmap.core.alignment import fit_rigid
from relmap.datasets import open_scans, read_relations
from relmap.datasets.scans import ScanLog, stored_scans
from relmap.evaluation import metrics
from relmap.evaluation.plane_evaluate import WallTruth, evaluate_planes
from relmap.evaluation.plane_run import PlaneRun, run_plane_mapper
from relmap.planes.pairwise import pairwise_map
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import Building, simulate_building

SIGMAS = (0.0, 0.05, 0.1, 0.2)
LOGS = (
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (0, 300)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (0, 800)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", (1600, 2400)),
    ("freiburg-079", "carmen-laser2d/freiburg-079-corrected.log.gz", None),
    ("MRPT simul", "mrpt-sim-laser2d/simul.scans.csv.gz", None),
)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--worlds", nargs="*", default=["building", "panels"])
    arguments = parser.parse_args()
    _print_simulated(arguments.worlds, arguments.seeds)
    if arguments.data is not None:
        _print_logs(arguments.data)


def _print_simulated(worlds: list[str], seeds: int) -> None:
    print(
        "| world | sigma [m] | seed | chained [m] | refined [m] | literal recipe [m] | mapped ",
        end="",
    )
    print("| false corners | ATE [m] | update [ms] | refine [ms] |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for world in worlds:
        for sigma in SIGMAS:
            for seed in range(seeds):
                print(f"| {world} | {sigma} | {seed} " + _simulated(world, sigma, seed), flush=True)


def _simulated(world: str, sigma: float, seed: int) -> str:
    building = simulate_building(sigma=sigma, seed=seed, world=world, sample_ends=sigma == 0.0)
    log, truth = _log_of(building), _truth_of(building)
    mapper = PlaneMapper()
    run = run_plane_mapper(mapper, log, PlaneSegmenter(), refine=False)
    chained = evaluate_planes(run.result, run.planes, truth)
    literal = _literal(mapper, run, truth)
    began = perf_counter()
    mapper.refine()
    refine_ms = 1e3 * (perf_counter() - began)
    result = replace(run.result, poses=mapper.trajectory, stamps_s=log.stamps_s)
    refined = evaluate_planes(result, mapper.planes, truth)
    update_ms = run.result.summary["timing"]["median_ms"]
    return (
        f"| {chained.corner_rmse_m:.3g} | {refined.corner_rmse_m:.3g} | {literal:.3g} "
        f"| {refined.coverage:.1%} | {refined.counts['false_corners']} | {refined.ate_m:.3g} "
        f"| {update_ms:.2f} | {refine_ms:.0f} |"
    )


def _log_of(building: Building) -> ScanLog:
    counts = [len(scan.points) for scan in building.scans]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    points = np.concatenate([scan.points for scan in building.scans])
    return stored_scans(points, offsets, building.stamps_s, building.trajectory)


def _truth_of(building: Building) -> WallTruth:
    ends = building.walls[:, :4].reshape(-1, 2, 2)
    return WallTruth(ends, building.times_seen()[:, 1:], building.stamps_s, building.trajectory)


def _literal(mapper: PlaneMapper, run: PlaneRun, truth: WallTruth) -> float:
    """Return the corner RMSE of the paper's literal recipe, from the same observations.

    Who is who is taken from the mapper's own map: corners are compared where it has them.
    """
    history = mapper.history
    ends = pairwise_map(history, int(history.plane.max()) + 1)
    table = run.planes
    row, end = np.nonzero(table.corner >= 0)
    R, t = fit_rigid(run.result.poses[:, :2, 3], truth.poses[:, :2, 3])
    own = table.ends[row, end] @ R.T + t
    apart = np.linalg.norm(truth.ends[:, end].swapaxes(0, 1) - own[:, None], axis=2)
    wall = apart.argmin(axis=1)
    placed = ends[table.plane[row], end]
    known = np.isfinite(placed[:, 0])
    placed, target = placed[known], truth.ends[wall, end][known]
    R, t = fit_rigid(placed, target)
    return metrics.rms(placed @ R.T + t - target) or 0.0


def _print_logs(data: Path) -> None:
    print("\n| log | scans | ATE [m] | poses | relations [m] | relations [deg] ", end="")
    print("| pieces | walls | update [ms] | segment [ms] | refine [s] |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name, path, interval in LOGS:
        log = open_scans(data / path)
        part = log if interval is None else log.between(*interval)
        run = run_plane_mapper(PlaneMapper(), part, PlaneSegmenter(view_rad=np.pi))
        print(f"| {name} | {interval or 'all'} " + _logged(run, part, data, name), flush=True)


def _logged(run: PlaneRun, log: ScanLog, data: Path, name: str) -> str:
    result = run.result
    assert log.poses is not None
    mine, other = metrics.match_stamps(result.stamps_s, log.stamps_s)
    ate = metrics.ate(result.poses[mine], log.poses[other], planar=True)
    shift = turn = np.nan
    if name == "freiburg-079":
        shift, turn = relation_errors(result.stamps_s, result.poses, data / "carmen-laser2d")
    timing = result.summary["timing"]
    return (
        f"| {ate:.3f} | {len(result.poses) / len(log):.1%} | {shift:.3f} | {turn:.2f} "
        f"| {len(result.summary['pieces'])} | {(run.planes.status == 'static').sum()} "
        f"| {timing['median_ms']:.2f} | {timing['segmentation_median_ms']:.2f} "
        f"| {timing['refine_ms'] / 1e3:.1f} |"
    )


def relation_errors(
    stamps_s: NDArray[np.float64], poses: NDArray[np.float64], folder: Path
) -> tuple[float, float]:
    """Return the mean error of poses against the checked relations: metres, degrees.

    The log has the logger's clock, the relations the robot's; `fr079.log.gz` has both.
    """
    relations = read_relations(folder / "fr079.relations")
    with gzip.open(folder / "fr079.log.gz", "rt") as stream:
        cells = [line.split()[-3:] for line in stream if line.startswith("ROBOTLASER1")]
    robot_s, logger_s = np.array([[float(a), float(b)] for a, _, b in cells]).T
    begin = np.interp(relations.begin_s, robot_s, logger_s)
    end = np.interp(relations.end_s, robot_s, logger_s)
    inside = (begin >= stamps_s[0]) & (end <= stamps_s[-1])
    T_begin, T_end = (_pose_at(stamps_s, poses, when[inside]) for when in (begin, end))
    off = np.linalg.inv(relations.T_begin_end[inside]) @ np.linalg.inv(T_begin) @ T_end
    shift = np.hypot(off[:, 0, 3], off[:, 1, 3])
    turn = np.abs(np.arctan2(off[:, 1, 0], off[:, 0, 0]))
    return float(shift.mean()), float(np.rad2deg(turn.mean()))


def _pose_at(
    stamps_s: NDArray[np.float64], poses: NDArray[np.float64], when: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return planar poses at some times, between those of the scans."""
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    x, y, angle = (np.interp(when, stamps_s, values) for values in (*poses[:, :2, 3].T, yaw))
    at = np.tile(np.eye(4), (len(when), 1, 1))
    at[:, 0, 0] = at[:, 1, 1] = np.cos(angle)
    at[:, 1, 0], at[:, 0, 1] = np.sin(angle), -np.sin(angle)
    at[:, 0, 3], at[:, 1, 3] = x, y
    return at


if __name__ == "__main__":
    main()
