"""Ctrl-C at the bytecodes of updates of every mapper; see test_interrupted.py.

    python -m tests.interrupting [--every N] [KIND ...]

At every N-th bytecode of relmap in one update a fork of the process is interrupted.  The interrupt
must come out of the update; then its mapper must report that it was interrupted, or continue to the
same map as if nothing had happened.  A fork that is not interrupted is a failure, and so is a kind
of mapper that no fork reported.
"""

from __future__ import annotations

import argparse
import gc
import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np

from relmap import Plane3dMapper, PlaneMapper, PointMapper, RelmapError
from relmap.simulation import simulate_building
from relmap.simulation.visibility import seen_walls
from tests.worlds import walk

LAST = 8
"""Number of scans after the interrupted one."""
REPORTED, SAME, OTHER, FAILED = range(4)
OUTCOMES = ("reported", "same map", "other map", "failed")


@dataclass(frozen=True)
class Kind:
    """A mapper, and the arguments of each of its updates."""

    make: Callable[[], Any]
    scans: list[dict[str, Any]]


def kinds() -> dict[str, Kind]:
    """Return the mappers that are interrupted, by name."""
    world = walk(3, 5, 0.02, iterations=30)
    building = simulate_building(181, 0.01, sampling="laser", iterations=25)
    steps = [[0.2, 0.0, 0.01]] * 30
    points = [{"points": points} for _, points in world.scans]
    known = [{"points": points, "ids": ids} for ids, points in world.scans]
    flat = [{"points": points} for _, points in walk(2, 5, 0.02, iterations=30).scans]
    walls = [{"points": s.seen, "beams": s.points[:, :2]} for s in building.scans]
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 3.0, 60)] * 2))
    room = np.concatenate([np.insert(np.column_stack([u, v]), k, 0.0, axis=1) for k in range(3)])
    clouds = [{"points": room - [x, 1.0, 1.0]} for x in np.linspace(1.0, 1.3, 12)]
    return {
        "points": Kind(PointMapper, points),
        "points-ids": Kind(PointMapper, known),
        "points-odometry": Kind(PointMapper, with_odometry(flat, steps)),
        "walls": Kind(PlaneMapper, walls),
        "walls-odometry": Kind(PlaneMapper, with_odometry(walls, steps)),
        "walls-onto": Kind(onto, walls),
        "planes3d": Kind(Plane3dMapper, clouds),
    }


def with_odometry(scans: list[dict[str, Any]], steps: list[Any]) -> list[dict[str, Any]]:
    return [scan | {"odometry": step} for scan, step in zip(scans, steps, strict=False)]


def onto() -> PlaneMapper:
    """Return a mapper that adds a log to a map."""
    room = np.array([[[3.0, -2.0], [3.0, 2.0]], [[3.0, 2.0], [-1.0, 2.0]]])
    mapper = PlaneMapper()
    for x in np.linspace(0.0, 0.5, 8):
        mapper.update(seen_walls(room - [x, 0.0], 8.0, 3.0), beams=room[:, 0] - [x, 0.0])
    mapper.finish()
    mapper.take_up(seen_walls(room, 8.0, 3.0), room[:, 0])
    return mapper


def told(mapper: Any) -> bytes:
    """Return the results of a mapper, to the last bit."""
    mapper.finish()
    table = mapper.planes.normal if isinstance(mapper, Plane3dMapper) else mapper.map.positions
    return bytes(table.tobytes() + mapper.trajectory.tobytes())


def outcome(mapper: Any, kind: Kind, at: int, begun: int, whole: bytes) -> int:
    """Interrupt the next update of a mapper, continue, and return the outcome."""
    try:
        interrupted(lambda: mapper.update(**kind.scans[len(kind.scans) - LAST]), at)
        for scan in kind.scans[mapper.n_iterations - begun :]:
            mapper.update(**scan)
        return SAME if told(mapper) == whole else OTHER
    except BaseException as error:  # noqa: BLE001 - a child must not return
        if isinstance(error, RelmapError) and "was interrupted" in str(error):
            return REPORTED
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return FAILED


def interrupted(work: Callable[[], object], at: int = 0) -> int:
    """Do something, with Ctrl-C at some bytecode of relmap; return how many it has, up to there.

    Without a bytecode it is only counted; AssertionError if an interrupt does not come out of it.
    """
    count, came_out = 0, False

    def step(frame: FrameType, event: str, argument: object) -> Any:
        nonlocal count
        if "relmap" not in frame.f_globals.get("__name__", ""):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            count += 1
            if count == at:
                raise KeyboardInterrupt
        return step

    before = sys.gettrace()
    frame = inspect.currentframe()
    frame.f_trace_opcodes = True  # without it Python 3.12 traces none
    gc.disable()  # an interrupt while earlier mappers are deleted would be lost
    sys.settrace(step)
    try:
        work()
    except KeyboardInterrupt:
        came_out = True
    finally:
        sys.settrace(before)
        gc.enable()
    if came_out != (at > 0):
        raise AssertionError(f"interrupted: {came_out}, at bytecode {at} of {count}")
    return count


def attacked(kind: Kind, every: int) -> dict[int, list[int]]:
    """Interrupt one update of a mapper at every so many bytecodes; return these by outcome."""
    whole_mapper, mapper = kind.make(), kind.make()
    begun, k = mapper.n_iterations, len(kind.scans) - LAST
    for scan in kind.scans[:k]:
        whole_mapper.update(**scan)
        mapper.update(**scan)
    length = interrupted(lambda: whole_mapper.update(**kind.scans[k]))
    for scan in kind.scans[k + 1 :]:
        whole_mapper.update(**scan)
    whole, found = told(whole_mapper), dict[int, list[int]]()
    for at in range(every, length, every):
        child = os.fork()
        if child == 0:
            os._exit(outcome(mapper, kind, at, begun, whole))
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        found.setdefault(status if status in range(FAILED) else FAILED, []).append(at)
    return found


def main() -> int:
    known = kinds()
    parser = argparse.ArgumentParser(description="Interrupt updates at their bytecodes.")
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(known))
    arguments = parser.parse_args()
    bad = 0
    for name in arguments.kinds or known:
        found = attacked(known[name], arguments.every)
        counts = {OUTCOMES[k]: len(at) for k, at in sorted(found.items())}
        wrong = found.get(OTHER, []) + found.get(FAILED, [])
        print(f"{name}: {counts}", *wrong, flush=True)
        bad += len(wrong) + (REPORTED not in found)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
