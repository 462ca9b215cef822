"""All real logs, and simulated logs of others: relmap compared with other methods.

    OMP_NUM_THREADS=1 python benchmarks/real.py DATA

prints one table in markdown; DATA is a folder of the real data sets. relmap has default settings,
no odometry (as with `--odometry none`) and no ids, unless the row names them. KISS-ICP and
small_gicp (``relmap[peers]``) get the same scans; batch least squares, and an EKF as MRPT ships it,
are given the ids.

  usable  of walls and clouds: fraction of the scans in submaps of ten scans or more with an ATE of
          at most 0.3 m each; of points: fraction of the landmarks seen ten times that are mapped
  error   of walls and clouds: ATE of the largest submap, of other methods of the whole path; of
          points: RMSE of the mapped landmarks seen ten times
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np
from laser import LOGS
from shared.judging import judged, share_right
from shared.tables import header, row
from space import BLOCKS, HALL, KITCHEN, Peer, ate_of, ate_of_peer, read

from relmap import Plane3dMapper, PlaneMapper, PointMapper
from relmap.comparison.baselines.icp import KissIcp, SmallGicp
from relmap.comparison.compare import Compared, in_own_process
from relmap.comparison.methods.registry import find_method
from relmap.datasets import open_log, open_scans
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.feeding import Association, feed
from relmap.evaluation.landmarks import identify, match_landmarks
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import FileSource
from relmap.evaluation.truth import read_truth

VICTORIA, MRPT, MRCLAM = "victoria-park", "mrpt-kf-slam", "mrclam-dataset6"
POINTS: dict[str, tuple[str, tuple[int, int] | None, str | None]] = {
    "MRPT kf-slam (2-D)": (f"{MRPT}/kf-slam_demo", None, None),
    "MRPT kf-slam 6D": (f"{MRPT}/kf-slam_6D_demo", None, None),
    "MRPT kf-slam 6D, noncentered": (f"{MRPT}/kf-slam_6D_demo_noncentered", None, None),
    "Victoria Park 1181:1642": (VICTORIA, (1181, 1642), VICTORIA),
    "Victoria Park 4220:4634": (VICTORIA, (4220, 4634), VICTORIA),
    "Victoria Park, all": (VICTORIA, None, VICTORIA),
    "DLR circles": ("dlr-circles", None, "dlr-circles"),
    "I-SLSJF simulation": ("slsjf-sim-8240", None, "slsjf-sim-8240"),
}
"""File or folder, iterations and truth; of MRPT's logs the truth is beside the log."""
DRIVEN: dict[str, tuple[str, Association]] = {
    "Victoria Park, odometry": (VICTORIA, "nearest"),
    "DLR circles, odometry": ("dlr-circles", "nearest"),
    "I-SLSJF simulation, odometry": ("slsjf-sim-8240", "nearest"),
    "MRCLAM 6, odometry, ids": (MRCLAM, "known"),
}
"""Logs mapped with their odometry: file or folder, and association."""
SPACE = {"hall, lidar": HALL, "kitchen, depth camera": KITCHEN, "AirSim blocks, lidar": BLOCKS}
"""Clouds mapped as planes in space."""
ICP = ("kiss-icp", "small-gicp")
TOLD = ("batch", "ekf-mrpt")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--log", default="*", help="a log, or a pattern; all by default")
    given = parser.parse_args()
    data = given.data
    header("log", "scans", "submaps", "usable", "relmap, error [m]", "other methods, error [m]")
    for name in filter(partial(fnmatch, pat=given.log), (*LOGS, *SPACE, *POINTS, *DRIVEN)):
        row(name, _row(data, name))


def _row(data: Path, name: str) -> str:
    if name in LOGS:
        return _walls(data / LOGS[name])
    if name in SPACE:
        return _space(data, SPACE[name])
    return _points(data, name) if name in POINTS else _driven(data, *DRIVEN[name])


def _walls(file: Path) -> str:
    log, mapper = open_scans(file), PlaneMapper()
    feed(mapper, log, "nearest", refine=True, odometry=False)
    submaps = judged(mapper, log)
    right = share_right(submaps[:, 0], submaps[:, 1], len(log))
    others = _others(ICP, FileSource(file, truth=file), "nearest", "ate_m")
    return f"{len(log)} | {len(submaps)} | {right:.0%} | {submaps[0, 1]:.3f} | {others}"


def _space(data: Path, folder: str) -> str:
    clouds, mapper = read(data, folder), Plane3dMapper()
    for cloud in clouds.points:
        mapper.update(mapper.segmenter.fit(cloud).patches_)
    mapper.finish()
    mapper.refine()
    scans = np.array([len(part.iteration) for part in mapper.submaps])
    ates = np.array([ate_of(part, clouds.poses) for part in mapper.submaps])
    right = share_right(scans, ates, len(clouds.points))
    methods: tuple[Peer, ...] = KissIcp, SmallGicp
    peers = zip(ICP, methods, strict=True)
    others = [
        f"{name} {ate_of_peer(peer, clouds):.3f}"
        for name, peer in peers
        if not find_method(name).missing
    ]
    row = f"{len(clouds.points)} | {len(scans)} | {right:.0%} | {ates[0]:.3f}"
    return f"{row} | {', '.join(others) or '-'}"


def _points(data: Path, name: str) -> str:
    path, scans, folder = POINTS[name]
    log = data / path if folder else data / f"{path}.observations.csv.gz"
    source = FileSource(log, None, scans, data / folder if folder else _truth_beside(log))
    own = in_own_process("relmap-points", source, "nearest", None)
    assert own.run is not None, own.note
    usable, submaps = f"{own.run.figures['coverage']:.0%}", len(own.run.result.submaps)
    error, others = _metres(own, "often_rmse_m"), _others(TOLD, source, "known", "often_rmse_m")
    return f"{len(source.load().log)} | {submaps} | {usable} | {error} | {others}"


def _driven(data: Path, path: str, association: Association) -> str:
    log, truth = open_log(data / path), read_truth(data / path.split("/")[0])
    run = run_mapper(PointMapper(), log, association, refine=True, odometry=True)
    found, seen = evaluate(run.result, truth, log), identify(run.result, log)
    often = match_landmarks(run.result, truth, seen, often=True)
    error = f"{often.rmse_m:.3f}" if often and often.rmse_m is not None else "-"
    return f"{len(log)} | {len(run.result.submaps)} | {found.coverage:.0%} | {error} | -"


def _truth_beside(log: Path) -> Path:
    return log.with_name(log.name.replace(".observations.csv.gz", "_ground_truth.txt"))


def _others(
    names: tuple[str, ...], source: FileSource, association: Association, figure: str
) -> str:
    runs = [
        in_own_process(name, source, association, None)
        for name in names
        if not find_method(name).missing
    ]
    return ", ".join(f"{run.method} {_metres(run, figure)}" for run in runs) or "-"


def _metres(one: Compared, figure: str) -> str:
    value = one.run.figures[figure] if one.run else None
    return "-" if value is None else f"{value:.3f}" if value < 100 else "lost"


if __name__ == "__main__":
    main()
