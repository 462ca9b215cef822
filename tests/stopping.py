"""Stops every verb that writes at each of its system calls that change files; see test_stopped.py.

    python -m tests.stopping [--every N] [--full N] [VERB ...]

From the files as they are before a call, which are those that a kill leaves, the same command or
`relmap resume` must end with the bytes of a run that was not stopped; only numbers that differ
between such runs may differ.  Before that no file is cut, and no old one is beside a new one.  With
``--full`` calls fail as well, with each later one that needs space on the disk: that must make no
difference, or end in one line and code 2, with the old files as they were.  Both take every Nth
call, or none for 0.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
import shutil
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from relmap.cli import console, main
from tests.commands import unrendered
from tests.journals import end_after
from tests.tracing import SPACE, traced

NUMBERS = re.compile(rb"([0-9a-f]{64}|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?|null)")
JOURNAL, DAMAGED, SUMMARY = Path("j"), Path("j.damaged"), "out/summary.json"
OTHER_LINES = re.compile("relmap: (compiling|mapping|[0-9]+ of)|.*(is skipped|borne out)")
"""Lines on the standard error that are not errors."""
FINE = re.compile("^(old|new|in part), then new|^no error, new|^one line, old")
Files = dict[str, bytes]

INPUTS = {
    "eight": "simulate figure-eight --iterations 40",
    "other": "simulate figure-eight --iterations 30 --seed 5",
    "bld": "simulate building --beams 181 --sigma 0.01 --iterations 40",
    "storey": "simulate storey --iterations 6",
    "old": "map other",
    "r1": "map eight --scans 0:28",
    "r2": "map eight --scans 14:40",
    "rw": "map bld --variant planes",
    "rw1": "map bld --variant planes --scans 0:26",
    "rw2": "map bld --variant planes --scans 14:40",
}
SWEEP = (
    'world = ["figure-eight"]\nseed = "{}"\niterations = [20]\ndensity = 25.0\n'
    'sigma = [0.02]\nmethod = ["relmap-points"]\nassociation = ["known"]\n'
)
POINTS, WALLS = "map eight -o out", "map bld -o out --variant planes"
CLOUDS, COMPARED = "map storey -o out --variant planes3d", "--methods relmap-points -o out"
OLD, OLD_WALLS, RECORDED = "map other -o out", f"{WALLS} --scans 0:26", f"{POINTS} --journal j"
VERBS = {
    "map": [OLD, POINTS],
    "map-journal": [OLD, RECORDED],
    "walls": [OLD_WALLS, WALLS],
    "walls-journal": [OLD_WALLS, f"{WALLS} --journal j"],
    "walls-animate": [OLD_WALLS, f"{WALLS} --animate"],
    "planes3d": [OLD, CLOUDS],
    "planes3d-journal": [OLD, f"{CLOUDS} --journal j"],
    "onto": [OLD, f"{POINTS} --onto r1"],
    "walls-onto": [OLD_WALLS, f"{WALLS} --onto rw"],
    "resume": [RECORDED, "cut", OLD, "resume j"],
    "salvage": [RECORDED, "damage", OLD, "resume j --salvage"],
    "merge": [OLD, "merge r1 r2 -o out"],
    "walls-merge": [OLD, "merge rw1 rw2 -o out"],
    "localise": ["localise other --map old -o out", "localise eight --map r1 -o out"],
    "walls-localise": ["localise other --map old -o out", "localise bld --map rw -o out"],
    "evaluate": [POINTS, "evaluate out --truth other", "evaluate out --truth eight"],
    "walls-evaluate": [WALLS, "evaluate out --truth bld"],
    "planes3d-evaluate": [CLOUDS, "evaluate out --truth storey"],
    "compare": [f"compare other {COMPARED}", f"compare eight {COMPARED}"],
    "sweep": ["sweep b.toml --workers 1 -o out", "sweep a.toml --workers 1 -o out"],
    "figures": ["figures 5 --quick -o out", "figures 4 --quick -o out"],
}
for world in ("figure-eight", "world", "building", "storey"):
    simulate = f"simulate {world} -o out --iterations"
    VERBS[f"simulate-{world}"] = [f"{simulate} 5 --seed 1", f"{simulate} 8"]
for form in ("dxf", "svg", "geojson", "g2o", "ply", "grid"):
    to = f"--to {form} -o out{'' if form == 'grid' else '.' + form}"
    VERBS[f"export-{form}"] = [f"export rw1 {to}", f"export rw {to}"]
    if form != "grid":
        VERBS[f"export-points-{form}"] = [f"export old {to}", f"export r1 {to}"]
"""By name: commands that wrote to the same folder before, and last the one that is stopped."""


def done(line: str) -> int:
    """Run a command of relmap, or one of those that change a journal."""
    if line == "cut":
        end_after(JOURNAL, 25)
    elif line == "damage":
        JOURNAL.write_bytes(JOURNAL.read_bytes()[:-5000] + bytes(5000))
    else:
        return main(line.split())
    return 0


def begin_from(root: Path, folder: str) -> None:
    """Change to a new copy of a folder."""
    os.chdir(root)
    shutil.rmtree("run", ignore_errors=True)
    shutil.copytree(folder, "run")
    os.chdir("run")


def files_in(folder: Path) -> Files:
    """Return the files of a folder, without hidden ones, journals and cells of a sweep."""
    names = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    hidden = re.compile(r"(.*/)?\.|j|out/cells/")
    return {name: path.read_bytes() for name, path in names.items() if not hidden.match(name)}


class Attack:
    """A command that is stopped."""

    def __init__(self, root: Path, lines: list[str]) -> None:
        self._root, self._command = root, lines[-1]
        begin_from(root, "inputs")
        if any(list(map(done, lines[:-1]))):
            raise SystemExit(f"{lines[:-1]}: failed")
        os.chdir(root)
        shutil.rmtree("begin", ignore_errors=True)
        shutil.move("run", "begin")
        self._before, runs = files_in(root / "begin"), list[Files]()
        for number in range(4):  # the first one here, so that nothing is left to load and compile
            begin_from(root, "begin")
            if number:
                self.calls = list(enumerate(traced(partial(done, lines[-1])).calls, 1))
            else:
                done(lines[-1])
            runs.append(files_in(root / "run"))
        self._whole = runs[0]
        timed = [name for name in runs[0] if len({run[name] for run in runs}) > 1]
        self._timed = {name: [NUMBERS.split(run[name]) for run in runs] for name in timed}

    def _is_new(self, name: str, content: bytes) -> bool:
        """Return whether a file is that of a whole run, but for the numbers that differ."""
        if name not in self._timed or name.endswith(".png"):
            return name in self._timed or content == self._whole.get(name)
        parts, runs = NUMBERS.split(content), self._timed[name]
        return len(parts) == len(runs[0]) and all(
            part in same or len(set(same)) > 1 for part, *same in zip(parts, *runs, strict=True)
        )

    def _seen(self) -> str:
        """Return the state of the files; in capitals if it is wrong."""
        now = files_in(self._root / "run")
        new = {name for name in now if self._is_new(name, now[name])}
        old = {name for name in now if now[name] == self._before.get(name)}
        if new == now.keys() == self._whole.keys():
            return "new"
        if now == self._before:
            return "old"
        if now.keys() - new - old:
            return f"CUT: {sorted(now.keys() - new - old)}"
        unread = SUMMARY in self._whole and SUMMARY not in now
        return "OLD BESIDE NEW" if new - old and old - new and not unread else "in part"

    def kept(self) -> list[tuple[int, str]]:
        """Keep the files before each call at which they are others; return these calls."""
        begin_from(self._root, "begin")
        shutil.rmtree(self._root / "kept", ignore_errors=True)
        found, last = list[tuple[int, str]](), list[object]()

        def keep(number: int, name: str) -> int:
            states = [(path, path.lstat()) for path in sorted(Path().rglob("*"))]
            now = [(path, s.st_ino, s.st_size, s.st_mtime_ns) for path, s in states]
            if now != last:
                shutil.copytree(".", self._root / "kept" / str(number))
                found.append((number, name))
                last[:] = now
            return 0

        traced(partial(done, self._command), keep)
        return found

    def killed(self, at: int) -> str:
        """Continue from the files before a call; return what was seen then and at the end."""
        begin_from(self._root, f"kept/{at}")
        left = self._seen()
        resumed = JOURNAL.exists() and ("--journal" in self._command or DAMAGED.exists())
        run = traced(partial(done, "resume j" if resumed else self._command))
        return f"{left}, then {f'CODE {run.code}: {run.said}' if run.code else self._seen()}"

    def failed(self, at: int) -> str:
        """Let a call fail; return what was said and seen."""

        def fail(number: int, name: str) -> int:
            if name in SPACE.values():
                return errno.ENOSPC if number >= at else 0
            return errno.EIO if number == at else 0

        begin_from(self._root, "begin")
        run = traced(partial(done, self._command), fail)
        said = [line for line in run.said.splitlines() if not OTHER_LINES.match(line)]
        if run.code == 0:
            return f"no error, {self._seen()} {said or ''}"
        fine = run.code == 2 and len(said) == 1 and said[0].startswith("relmap: error: ")
        return f"{'one line' if fine else f'CODE {run.code}: {said}'}, {self._seen()}"


def prepare(folder: Path, names: Iterable[str]) -> None:
    """Make the inputs of some verbs, unless they are there."""
    needed = {word for name in names for line in VERBS[name] for word in line.split()}
    for name, line in reversed(INPUTS.items()):
        needed |= set(line.split()) if name in needed else set()
    os.chdir(folder)
    for name in [name for name in INPUTS if name in needed and not Path(name).exists()]:
        done(f"{INPUTS[name]} -o {name}")
    for name, seeds in (("a", "0:2"), ("b", "1:3")):
        Path(f"{name}.toml").write_text(SWEEP.format(seeds))


@unrendered()
def main_() -> int:
    parser = argparse.ArgumentParser(description="Stop every verb at its system calls.")
    parser.add_argument("--every", type=int, default=1, metavar="N")
    parser.add_argument("--full", type=int, default=0, metavar="N", help="let calls fail, too")
    parser.add_argument("--root", type=Path, help="folder to work in, with the inputs of before")
    parser.add_argument("verbs", nargs="*", metavar="VERB", help=", ".join(VERBS))
    arguments = parser.parse_args()
    console.EVERY_S = 1e6
    root = arguments.root or Path(tempfile.mkdtemp(prefix="relmap-stopping-"))
    (root / "inputs").mkdir(parents=True, exist_ok=True)
    names, bad = arguments.verbs or list(VERBS), 0
    prepare(root / "inputs", names)
    for name in names:
        attack, found = Attack(root, VERBS[name]), defaultdict[str, list[str]](list)
        for at, call in attack.kept()[:: arguments.every] if arguments.every else ():
            found[attack.killed(at)].append(f"{at} {call}")
        for at, call in attack.calls[:: arguments.full] if arguments.full else ():
            found[attack.failed(at)].append(f"{at} {call}")
        print(f"{name}: {len(attack.calls)} calls", flush=True)
        for what, where in found.items():
            print(f"  {len(where)} times {what}: {', '.join(where[:6])}", flush=True)
            bad += not FINE.search(what)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main_())
