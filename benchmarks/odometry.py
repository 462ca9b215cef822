"""Maps from observations and odometry, compared with batch least squares.

    OMP_NUM_THREADS=1 python benchmarks/odometry.py DATA [--log NAME] [--from-map]

prints one table in markdown; DATA is a folder of the real data sets. relmap maps each log with
default settings and the published ids, or where the row says so with its own association. The batch
(in `references/`) has the published ids, or where the row says so relmap's matches as ids. It
starts from odometry, with `--from-map` from relmap's map, which takes minutes less on long logs;
Huber's loss first makes the result independent of the start. GTSAM (``relmap[peers]``) starts where
the batch does. Both get the residuals and the noise that relmap estimates, with Cauchy's loss.
Errors are RMS over the mapped landmarks seen ten times, after rigid alignment.

  error      from the true landmarks, where these are known
  apart      from those of the batch
  residuals  those of relmap's map over those of the batch: root of the ratio of the least costs,
             with relmap's landmarks fixed and with all unknowns free
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np
from references.gtsam_chain import peer_solved
from references.pose_chain import (
    CONVEX,
    Floats,
    Ints,
    Problem,
    State,
    laid_on,
    placed,
    solved,
    start,
)
from shared.tables import header, row

from relmap import PointMapper
from relmap.core.arrays import Bools
from relmap.datasets import open_log
from relmap.datasets.base import ObservationLog
from relmap.evaluation.feeding import Association, feed
from relmap.evaluation.metrics import majority_ids
from relmap.evaluation.truth import read_truth

MRCLAM = "mrclam-dataset6"
OWN, MATCHES = ", own association", ", own association; batch of its matches"
LOGS = {
    "Victoria Park": ("victoria-park", ""),
    f"Victoria Park{OWN}": ("victoria-park", ""),
    "DLR circles": ("dlr-circles", ""),
    f"DLR circles{OWN}": ("dlr-circles", ""),
    f"DLR circles{MATCHES}": ("dlr-circles", ""),
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
    parser.add_argument("--from-map", action="store_true", help="start from relmap's map")
    given = parser.parse_args()
    errors, apart = ("error [m]: relmap", "batch", "GTSAM"), ("apart [m]: relmap", "GTSAM")
    header("log", "landmarks", *errors, *apart, "residuals")
    for name in filter(partial(fnmatch, pat=given.log), LOGS):
        path, truth = LOGS[name]
        log, truth_folder = open_log(given.data / path), truth and given.data / truth
        association: Association = "nearest" if OWN in name else "known"
        takes = name.endswith(MATCHES)
        row(name, *_cells(log, truth_folder, association, takes, given.from_map))


def _cells(
    log: ObservationLog,
    truth: Path | str,
    association: Association,
    takes_matches: bool,
    from_map: bool,
) -> list[str]:
    mapper = PointMapper()
    labels = np.concatenate(feed(mapper, log, association, refine=True, odometry=True).labels)
    if takes_matches:
        log = replace(log, ids=mapper.landmarks_of(labels))
    assert log.ids is not None
    problem, ids = problem_of(log, mapper)
    own = _placed(mapper, ids, log.ids, labels)
    first = _begun(problem, own, mapper) if from_map else start(problem)
    begun = solved(problem, first, loss=CONVEX)
    batch = solved(problem, begun)
    peer = peer_solved(problem, begun, batch.constant)
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
    return [*cells, f"{ratio:.3f}"]


def _placed(mapper: PointMapper, ids: Ints, true_ids: Ints, labels: Ints) -> Floats:
    """Return where relmap maps each id; by its most observed landmark, if it has several."""
    landmark, found = mapper.landmarks_of(labels), np.full((len(ids), 2), np.nan)
    of, label, seen = majority_ids(landmark, true_ids)
    positions = dict(zip(mapper.map.landmark_ids.tolist(), mapper.map.positions, strict=True))
    for k in np.argsort(seen, kind="stable").tolist():
        if of[k] in positions:
            found[np.searchsorted(ids, label[k])] = positions[of[k]][:2]
    return found


def _begun(problem: Problem, own: Floats, mapper: PointMapper) -> State:
    """Return relmap's map as a start of the batch."""
    assert mapper.odometry is not None
    T = mapper.odometry.poses
    poses = np.column_stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])
    state = State(np.nan_to_num(poses), own, np.zeros(3))
    return replace(state, landmarks=placed(problem, state))


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
    sd = np.column_stack(use.noise.sigmas(odometry)) * use.sigmas[1:]
    seen = np.flatnonzero(log.ids >= 0)
    ids, landmark = np.unique(log.ids[seen], return_inverse=True)
    noise_m = max(refined.noise_m for refined in mapper.refined)
    roots = np.tile(np.eye(2) / noise_m, (len(seen), 1, 1))
    if log.covariances is not None:
        usual = np.trace(log.covariances, axis1=1, axis2=2).mean() / 2
        roots = np.linalg.inv(np.linalg.cholesky(log.covariances[seen] / usual)) / noise_m
    pose = log.iteration[seen] - log.first_iteration
    return Problem(log.points_robot[seen, :2], pose, landmark, roots, motion, sd), ids


def _laid(batch: State, own: Floats) -> State:
    """Return the batch's state in the frame of another map."""
    shared = np.isfinite(own[:, 0])
    R, t = laid_on(batch.landmarks[shared], own[shared])
    turn = np.arctan2(R[1, 0], R[0, 0])
    poses = np.column_stack([batch.poses[:, :2] @ R.T + t, batch.poses[:, 2] + turn])
    return State(poses, batch.landmarks @ R.T + t, batch.constant)


def _apart(often: Bools, found: Floats | None, other: Floats) -> float | None:
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
