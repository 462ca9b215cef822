"""Ctrl-C at the bytecodes of updates of every mapper; see test_interrupted.py.

    python -m tests.interrupting [--every N] [KIND ...]

At every N-th bytecode of relmap in an update the process forks, and the child is interrupted there.
Its mapper must report that, or continue to the same map as if nothing had happened.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
from collections import Counter
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


def outcome(mapper: Any, kind: Kind, begun: int, whole: bytes) -> int:
    """Continue an interrupted mapper, and return the outcome."""
    try:
        for scan in kind.scans[mapper.n_iterations - begun :]:
            mapper.update(**scan)
        return SAME if told(mapper) == whole else OTHER
    except BaseException as error:  # noqa: BLE001 - a child must not return
        if isinstance(error, RelmapError) and "was interrupted" in str(error):
            return REPORTED
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return FAILED


class Forker:
    """Forks at every so many bytecodes of relmap; `child` is true in what was forked."""

    def __init__(self, every: int) -> None:
        self.every, self.count, self.child = every, 0, False
        self.outcomes: Counter[int] = Counter()
        self.at: list[str] = []

    def step(self, frame: FrameType, event: str, argument: object) -> Any:
        if "relmap" not in frame.f_globals.get("__name__", ""):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and not self.child:
            self.count += 1
            if self.count % self.every == 0:
                self._fork(frame)
        return self.step

    def _fork(self, frame: FrameType) -> None:
        child = os.fork()
        if child == 0:
            self.child = True
            raise KeyboardInterrupt
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        found = status if status in range(FAILED) else FAILED
        self.outcomes[found] += 1
        if found in (OTHER, FAILED):
            self.at.append(f"{frame.f_code.co_filename}:{frame.f_lineno}")


def attacked(kind: Kind, every: int) -> Forker:
    """Interrupt one update of a mapper at every so many bytecodes."""
    whole_mapper, mapper = kind.make(), kind.make()
    begun = mapper.n_iterations
    for scan in kind.scans:
        whole_mapper.update(**scan)
    whole = told(whole_mapper)
    k = len(kind.scans) - LAST
    for scan in kind.scans[:k]:
        mapper.update(**scan)
    forker = Forker(every)
    frame = inspect.currentframe()
    assert frame is not None
    frame.f_trace_opcodes = True  # without it Python 3.12 traces none
    sys.settrace(forker.step)
    try:
        mapper.update(**kind.scans[k])
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(None)
    if forker.child:
        os._exit(outcome(mapper, kind, begun, whole))
    return forker


def main() -> int:
    known = kinds()
    parser = argparse.ArgumentParser(description="Interrupt updates at their bytecodes.")
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(known))
    arguments = parser.parse_args()
    bad = 0
    for name in arguments.kinds or known:
        forker = attacked(known[name], arguments.every)
        counts = {OUTCOMES[k]: n for k, n in sorted(forker.outcomes.items())}
        print(f"{name}: {forker.count} bytecodes, {counts}", *sorted(set(forker.at)), flush=True)
        bad += forker.outcomes[OTHER] + forker.outcomes[FAILED]
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
