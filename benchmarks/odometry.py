"""Maps from observations with ids and odometry, compared with batch least squares.

    OMP_NUM_THREADS=1 python benchmarks/odometry.py DATA [--log NAME]

prints one table in markdown; DATA is a folder of the real data sets. relmap maps each log with
default settings. The batch (in `references/`) starts from odometry; GTSAM (``relmap[peers]``)
starts where the batch does. Both get the residuals and the noise that relmap estimates, with
Cauchy's loss. Errors are RMS over the mapped landmarks seen ten times, after rigid alignment.

  error      from the true landmarks, where these are known
  apart      from those of the batch
  residuals  those of relmap's map over those of the batch: root of the ratio of the least costs,
             with relmap's landmarks fixed and with all unknowns free
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np
from references.gtsam_chain import peer_solved
from references.pose_chain import CONVEX, Floats, Ints, Problem, State, laid_on, solved, start

from relmap import PointMapper
from relmap.datasets import open_log
from relmap.datasets.base import ObservationLog
from relmap.evaluation.feeding import feed
from relmap.evaluation.truth import read_truth

MRCLAM = "mrclam-dataset6"
LOGS = {
    "Victoria Park": ("victoria-park", ""),
    "DLR circles": ("dlr-circles", ""),
    "I-SLSJF simulation": ("slsjf-sim-8240", "slsjf-sim-8240"),
    **{
        f"MRCLAM 6, robot {k}": (f"{MRCLAM}/Robot{k}_Measurement.dat.gz", MRCLAM)
        for k in range(1, 6)
    },
    "MRCLAM 6, all five": (MRCLAM, MRCLAM),
}
"""The log, and the folder of its truth."""
OFTEN = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--log", default="*", help="a log, or a pattern; all by default")
    given = parser.parse_args()
    print(
        "| log | landmarks | error [m]: relmap | batch | GTSAM | "
        "apart [m]: relmap | GTSAM | residuals |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in filter(partial(fnmatch, pat=given.log), LOGS):
        path, truth = LOGS[name]
        print(f"| {name} | {_row(given.data / path, truth and given.data / truth)} |", flush=True)


def _row(path: Path, truth: Path | str) -> str:
    log = open_log(path)
    assert log.ids is not None
    mapper = PointMapper()
    feed(mapper, log, "known", refine=True, odometry=True)
    problem, ids = problem_of(log, mapper)
    begun = solved(problem, start(problem), loss=CONVEX)
    batch = solved(problem, begun)
    peer = peer_solved(problem, begun, batch.constant)
    own = np.full((len(ids), 2), np.nan)
    own[np.searchsorted(ids, mapper.map.landmark_ids)] = mapper.map.positions[:, :2]
    often = np.isfinite(own[:, 0]) & (np.bincount(problem.landmark, minlength=len(ids)) >= OFTEN)
    true = np.full((len(ids), 2), np.nan)
    if truth:
        known = read_truth(Path(truth))
        of = np.isin(known.landmark_ids, ids)
        true[np.searchsorted(ids, known.landmark_ids[of])] = known.landmarks_map[of, :2]
    apart = partial(_apart, often)
    maps = own, batch.landmarks, peer
    errors = [apart(found, true) for found in maps]
    others = [apart(found, batch.landmarks) for found in (own, peer)]
    seen = np.bincount(problem.landmark) >= OFTEN
    ratio = np.sqrt(solved(problem, _laid(batch, own), own).cost / batch.cost)
    cells = [f"{often.sum()} of {seen.sum()}", *map(_metres, errors), *map(_metres, others)]
    return " | ".join([*cells, f"{ratio:.3f}"])


def problem_of(log: ObservationLog, mapper: PointMapper) -> tuple[Problem, Ints]:
    """Return the least-squares problem of a log with the noise that relmap found, and its ids."""
    use = mapper.odometry
    assert log.ids is not None
    assert log.odometry is not None
    assert use is not None
    odometry = use.noise.corrected(log.odometry)
    odometry[0] = np.nan
    motion = np.column_stack(
        [odometry[:, 0, 3], odometry[:, 1, 3], np.arctan2(odometry[:, 1, 0], odometry[:, 0, 0])]
    )
    seen_sigma, *factors = use.sigmas
    sd = np.column_stack(use.noise.sigmas(odometry)) * factors
    seen = np.flatnonzero(log.ids >= 0)
    ids, landmark = np.unique(log.ids[seen], return_inverse=True)
    if log.covariances is None:
        noise_m = max(refined.noise_m for refined in mapper.refined)
        roots = np.tile(np.eye(2) / noise_m, (len(seen), 1, 1))
    else:
        roots = np.linalg.inv(np.linalg.cholesky(log.covariances[seen])) / seen_sigma
    pose = log.iteration[seen] - log.first_iteration
    return Problem(log.points_robot[seen, :2], pose, landmark, roots, motion, sd), ids


def _laid(batch: State, own: Floats) -> State:
    """Return the batch's state in the frame of another map."""
    shared = np.isfinite(own[:, 0])
    R, t = laid_on(batch.landmarks[shared], own[shared])
    turn = np.arctan2(R[1, 0], R[0, 0])
    poses = np.column_stack([batch.poses[:, :2] @ R.T + t, batch.poses[:, 2] + turn])
    return State(poses, batch.landmarks @ R.T + t, batch.constant)


def _apart(often: Ints, found: Floats | None, other: Floats) -> float | None:
    """Return the RMS distance of landmarks from others; None if either is unknown."""
    if found is None:
        return None
    both = often & np.isfinite(found[:, 0]) & np.isfinite(other[:, 0])
    if both.sum() < 2:
        return None
    R, t = laid_on(found[both], other[both])
    off = found[both] @ R.T + t - other[both]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


if __name__ == "__main__":
    main()
