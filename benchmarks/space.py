"""Planes in space: logs of lidars and depth cameras, and variants not used for tuning.

    OMP_NUM_THREADS=1 python benchmarks/space.py DATA [--log hall 'storey*'] [--peers]

prints one table in markdown; DATA is a folder of the real data sets.  Settings are the defaults.

  largest  scans in the largest submap
  weak     scans of all submaps that `weak_links` lists: undetermined in some direction
  right    fraction of the scans in submaps of at least two scans with an ATE of at most 5 cm
  ATE      of the largest submap, and the worst of all submaps
  turn     median error of the rotation from scan to scan, degrees
  wrong    steps between neighbouring scans of a submap, neither of them listed as weak, that are
           off by more than 10 cm or 3 degrees: silently wrong
  recall   of the true planes over 0.25 m2 that two scans saw, the fraction that is mapped, and the
           fraction of mapped ones that are true; of simulated logs (`relmap.evaluation.space`)
  double   fraction of the area of planes that another plane of the map covers
  ms       median processor times of the segmentation and of the placement of a scan; `last` is
           that of `finish` and `refine`, seconds

With ``--peers`` KISS-ICP and small_gicp (``relmap[peers]``) get the clouds of the logs themselves;
the last columns are their ATE in metres and their time, ms a scan.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from time import process_time

import numpy as np
from shared.clouds import Clouds, around, disturbed, elevated, noise, thinned, view
from shared.judging import step_errors
from shared.tables import header, row

from relmap import Plane3dMapper
from relmap.comparison.baselines.icp import KissIcp, SmallGicp
from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from relmap.evaluation import metrics
from relmap.evaluation.space import Faces, doubled_area, judge_planes
from relmap.planes3d.submap import Submap
from relmap.simulation.storey import simulate_storey

RIGHT_M, WRONG_M, WRONG_RAD = 0.05, 0.1, np.deg2rad(3.0)
HALL, KITCHEN, BLOCKS = "lidar3d-hall", "rgbd-7scenes-redkitchen", "airsim-blocks-lidar"
Peer = type[KissIcp] | type[SmallGicp]


def read(data: Path, name: str) -> Clouds:
    """Return a real log."""
    scans = list(open_scans(data / name).scans())
    points = [scan.points_robot for scan in scans]
    return Clouds(points, np.array([scan.T_reference_robot for scan in scans]))


def stored(
    sensor: str, sigma: float, seed: int, iterations: int = 60, storeys: int = 1, moving: int = 0
) -> Clouds:
    """Return a simulated storey or house."""
    world = simulate_storey(
        sensor,  # type: ignore[arg-type]
        sigma,
        iterations,
        seed,
        storeys,
        moving,
    )
    faces = Faces(world.plane_of, world.corners, world.seen_m2)
    return Clouds(world.scans, world.trajectory, faces)


def hall(data: Path) -> Iterator[tuple[str, Callable[[], Clouds]]]:
    """Yield the hall and variants of it."""
    whole = read(data, HALL)
    yield "hall", lambda: whole
    yield "hall/reversed", partial(whole.only, slice(None, None, -1))
    for step in (2, 3, 4):
        yield f"hall/every-{step}", partial(whole.only, slice(None, None, step))
    for degrees in (20, 90, 180):
        yield f"hall/tilted-{degrees}", partial(whole.tilted, np.deg2rad(degrees))
    for sigma in (0.02, 0.05, 0.1):
        yield f"hall/noise-{sigma}", partial(whole.changed, noise(sigma))
    for share in (0.25, 0.1, 0.03):
        yield f"hall/points-{share}", partial(whole.changed, thinned(share))
    for degrees in (90, 60, 30):
        yield f"hall/view-{2 * degrees}", partial(whole.changed, view(np.deg2rad(degrees)))
        for way in (90, 180, 270):
            part = around(np.deg2rad(way), np.deg2rad(degrees))
            yield f"hall/view-{2 * degrees}-to-{way}", partial(whole.changed, part)
    yield "hall/view-150", partial(whole.changed, view(np.deg2rad(75)))
    for far_m in (15, 12, 10, 8, 6):
        yield f"hall/near-{far_m}m", partial(whole.changed, view(np.pi, far_m))
    yield "hall/no-floor", partial(whole.changed, elevated(np.deg2rad(-5), np.pi))
    yield "hall/no-ceiling", partial(whole.changed, elevated(-np.pi, np.deg2rad(5)))
    yield from disturbed("hall", whole)


def kitchen(data: Path) -> Iterator[tuple[str, Callable[[], Clouds]]]:
    """Yield the kitchen and variants of it."""
    whole = read(data, KITCHEN)
    yield "kitchen", lambda: whole
    yield "kitchen/reversed", partial(whole.only, slice(None, None, -1))
    yield "kitchen/first-half", partial(whole.only, slice(0, 175))
    yield "kitchen/second-half", partial(whole.only, slice(175, None))
    for step in (3, 5, 10, 20, 40):
        yield f"kitchen/every-{step}", partial(whole.only, slice(None, None, step))
        yield f"kitchen/every-{step}+{step // 2}", partial(whole.only, slice(step // 2, None, step))
    tenth = whole.only(slice(3, None, 7))
    yield "kitchen/every-7-reversed", partial(tenth.only, slice(None, None, -1))
    for sigma in (0.01, 0.03):
        yield f"kitchen/every-7-noise-{sigma}", partial(tenth.changed, noise(sigma, True))
    for share in (0.25, 0.05):
        yield f"kitchen/every-7-points-{share}", partial(tenth.changed, thinned(share))
    yield "kitchen/every-7-tilted-180", partial(tenth.tilted, np.pi)
    yield "kitchen/every-7-view-30", partial(tenth.changed, view(np.deg2rad(15)))
    yield "kitchen/every-7-upper", partial(tenth.changed, elevated(0.0, np.pi))
    yield "kitchen/every-7-lower", partial(tenth.changed, elevated(-np.pi, 0.0))
    for way in (15, -15):
        part = around(np.deg2rad(way), np.deg2rad(15))
        yield f"kitchen/every-7-view-30-to-{way}", partial(tenth.changed, part)
    for far_m in (2, 3):
        yield f"kitchen/every-7-near-{far_m}m", partial(tenth.changed, view(np.pi, far_m))
    yield from disturbed("kitchen/every-7", tenth)


def blocks(data: Path) -> Iterator[tuple[str, Callable[[], Clouds]]]:
    """Yield the blocks and variants of them."""
    whole = read(data, BLOCKS)
    yield "blocks", lambda: whole
    yield "blocks/reversed", partial(whole.only, slice(None, None, -1))
    yield "blocks/every-2", partial(whole.only, slice(None, None, 2))
    yield "blocks/points-0.3", partial(whole.changed, thinned(0.3))
    yield "blocks/noise-0.05", partial(whole.changed, noise(0.05))
    yield "blocks/tilted-90", partial(whole.tilted, np.deg2rad(90))
    yield "blocks/view-120", partial(whole.changed, view(np.deg2rad(60)))
    yield "blocks/no-ceiling", partial(whole.changed, elevated(-np.pi, np.deg2rad(5)))
    yield from disturbed("blocks", whole)


def storeys(_: Path) -> Iterator[tuple[str, Callable[[], Clouds]]]:
    """Yield simulated storeys."""
    for sensor, sigmas in (("lidar", (0.0, 0.01, 0.02, 0.05)), ("depth", (0.0, 0.005, 0.01, 0.02))):
        for sigma in sigmas:
            for seed in (0, 7) if sigma else (0,):
                yield f"storey/{sensor}-{sigma}-seed-{seed}", partial(stored, sensor, sigma, seed)
        yield f"storey/{sensor}-20-scans", partial(stored, sensor, 0.01, 1, 20)
    for sensor, sigma, scans in (("lidar", 0.01, 60), ("depth", 0.005, 60)):
        for seed in (0, 1, 3):
            given = sensor, sigma, seed, scans, 1, 2
            yield f"storey/{sensor}-2-boxes-seed-{seed}", partial(stored, *given)
    for sensor, sigma, each in (("lidar", 0.01, (60, 150)), ("depth", 0.005, (150, 300))):
        for scans in each:
            yield f"storey/house-{sensor}-{scans}", partial(stored, sensor, sigma, 0, scans, 2)
        given = sensor, sigma, 1, each[1], 2, 3
        yield f"storey/house-{sensor}-3-boxes", partial(stored, *given)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--log", nargs="+", default=["*"], help="logs, or patterns; default all")
    parser.add_argument("--peers", action="store_true", help="KISS-ICP and small_gicp beside it")
    given = parser.parse_args()
    both: dict[str, Peer] = {"kiss_icp": KissIcp, "small_gicp": SmallGicp}
    known = both if given.peers else {}
    peers = [peer for name, peer in known.items() if find_spec(name)]
    if len(peers) < len(known):
        print("KISS-ICP or small_gicp is not installed (pip install 'relmap[peers]'): left out")
    columns = "log scans submaps largest weak right ATE turn wrong planes recall double ms last"
    header(*columns.split(), *(peer.__name__ for peer in peers))
    for source in (hall, kitchen, blocks, storeys):
        kind = source.__name__.replace("storeys", "storey")
        if not any(fnmatch(kind, log.split("/")[0]) for log in given.log):
            continue
        for name, made in source(given.data):
            if any(fnmatch(name, log) for log in given.log):
                clouds = made()
                beside = ["" if "/" in name else _peer(peer, clouds) for peer in peers]
                row(name, *_cells(clouds), *beside)


def _cells(clouds: Clouds) -> list[str]:
    mapper, spent = Plane3dMapper(), []
    for cloud in clouds.points:
        began = process_time()
        seen = mapper.segmenter.fit(cloud).patches_
        between = process_time()
        mapper.update(seen)
        spent.append([between - began, process_time() - between])
    began = process_time()
    mapper.finish()
    mapper.refine()
    last_s, parts = process_time() - began, mapper.submaps
    ms = 1000 * np.median(spent, axis=0)
    ates = np.array([ate_of(part, clouds.poses) for part in parts])
    scans = np.array([len(part.iteration) for part in parts])
    weak = mapper.weak_links
    wrong, turns = _steps(parts, clouds.poses, set(weak))
    right = scans[(scans > 1) & (ates <= RIGHT_M)].sum() / len(clouds.points)
    turn = np.rad2deg(np.median(turns)) if len(turns) else np.nan
    return [
        f"{len(clouds.points)} | {len(parts)} | {scans.max(initial=0)} | {len(weak)} | {right:.0%}",
        f"{ates[0] if len(ates) else np.nan:.3f}, {ates.max(initial=0):.3f} | {turn:.2f}",
        f"{wrong} | {(mapper.planes.status == 'static').sum()}",
        f"{_found(mapper, clouds)} | {doubled_area(mapper.planes) or 0:.1%}",
        f"{ms[0]:.0f} + {ms[1]:.0f}",
        f"{last_s:.1f}",
    ]


def _found(mapper: Plane3dMapper, clouds: Clouds) -> str:
    if clouds.faces is None or not mapper.submaps:
        return ""
    rows = mapper.submaps[0].iteration
    poses = mapper.trajectory[rows], clouds.poses[rows]
    found = judge_planes(mapper.planes, clouds.faces, *poses)
    return f"{found['plane_recall'] or 0:.2f}, {found['plane_precision'] or 0:.2f}"


def ate_of(part: Submap, poses: Floats) -> float:
    """Return the ATE of a submap, metres."""
    return float(metrics.ate(part.trajectory, poses[part.iteration], False) or 0.0)


def _steps(parts: list[Submap], poses: Floats, weak: set[int]) -> tuple[int, Floats]:
    """Return the number of steps silently wrong, and the error of each rotation, radians."""
    wrong, turns = 0, []
    for part in parts:
        shift, turn = step_errors(part.trajectory, poses[part.iteration])
        named = np.array([bool(weak & {a, b}) for a, b in pairwise(part.iteration)], dtype=bool)
        wrong += int((((shift > WRONG_M) | (turn > WRONG_RAD)) & ~named).sum())
        turns.append(turn)
    return wrong, np.concatenate([*turns, np.empty(0)])


def _peer(peer: Peer, clouds: Clouds) -> str:
    began = process_time()
    ate = ate_of_peer(peer, clouds)
    return f"{ate:.3f}, {1000 * (process_time() - began) / len(clouds.points):.0f}"


def ate_of_peer(peer: Peer, clouds: Clouds) -> float:
    """Return the ATE of another method, metres."""
    method = peer(max(float(np.linalg.norm(cloud, axis=1).max()) for cloud in clouds.points))
    for cloud in clouds.points:
        method.update(cloud)
    return float(metrics.ate(method.trajectory, clouds.poses, False) or 0.0)


if __name__ == "__main__":
    main()
