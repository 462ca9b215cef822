"""Stops every verb that writes, but `demo`, at its calls that change files; see test_stopped.py.

    python -m tests.stopping [--every N] [--full N] [VERB ...]

Every run must really be stopped: it must die by SIGKILL, or a call of it must be refused; a stop
that does not happen is a failure, and so is a verb of which no call was stopped.

From the files that a kill at a call leaves, the same command or `relmap resume` must end with the
bytes of a run that was not stopped; only numbers that differ between such runs may differ.  Before
that no file is cut, and no old one is beside a new one.  With ``--full`` calls that need space on
the disk fail as well, and all later ones: that must make no difference, or end in one line and
code 2, with the old files as they were.  Both take every Nth call, or none for 0.  The calls are
those that Python reports to audit hooks; `tests.killing` stops runs amid what SQLite writes.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
import shutil
import signal
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from relmap.cli import console, main
from tests.commands import unrendered
from tests.journals import end_after

NUMBERS = re.compile(rb"([0-9a-f]{64}|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?|null)")
JOURNAL, DAMAGED, SUMMARY = Path("j"), Path("j.damaged"), "out/summary.json"
OTHER_LINES = re.compile("relmap: (compiling|mapping|[0-9]+ of)|.*(is skipped|borne out)")
"""Lines on the standard error that are not errors."""
FINE = re.compile("^(old|new|in part), then new|^no error, new|^one line, old")
SPACE = {"open", "os.mkdir", "os.link", "os.symlink", "sqlite3.connect"}
"""Calls that fail on a full disk."""
CALLS = SPACE | {"os.remove", "os.rename", "os.rmdir", "os.truncate", "os.chmod", "os.utime"}
REFUSED = "refused"
"""Stands after the name of a call that failed, where calls are noted."""
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


@dataclass(frozen=True)
class Stopped:
    """Exit code (negative: killed by that signal), names of the calls, standard error.

    `n_refused`: number of calls that failed because the disk was full.
    """

    code: int
    calls: list[str]
    said: str
    n_refused: int


def stopped(work: Callable[[], int], at: int = 0, full: bool = False) -> Stopped:
    """Run a function that returns an exit code, in a fork that is killed before a call.

    With a full disk it fails instead, and so does each later one that needs space.
    """
    sys.stdout.flush()
    with tempfile.TemporaryFile() as calls, tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(said.fileno(), 2)
            code = 99
            try:
                _stop_at(calls.fileno(), at, full)
                code = work()
            finally:
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        calls.seek(0)
        said.seek(0)
        names = calls.read().decode().split()
        made = [name for name in names if name != REFUSED]
        return Stopped(code, made, said.read().decode(), len(names) - len(made))


def _stop_at(calls: int, at: int, full: bool) -> None:
    """Have this process note its calls in a file, and stop or fail at one."""
    number = 0

    def hook(name: str, given: tuple[Any, ...]) -> None:
        nonlocal number
        if name not in CALLS or (name == "open" and not given[2] & (os.O_ACCMODE | os.O_CREAT)):
            return
        number += 1
        os.write(calls, f"{name}\n".encode())
        if number == at and not full:
            os.kill(os.getpid(), signal.SIGKILL)
        if 0 < at <= number and name in SPACE:
            os.write(calls, f"{REFUSED}\n".encode())
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    sys.addaudithook(hook)


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
                self.calls = list(enumerate(stopped(partial(done, lines[-1])).calls, 1))
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

    def killed(self, at: int) -> str:
        """Continue from what a kill at a call leaves; return what was seen then and at the end."""
        begin_from(self._root, "begin")
        code = stopped(partial(done, self._command), at).code
        if code != -signal.SIGKILL:
            return f"NOT KILLED: CODE {code}"
        left = self._seen()
        resumed = JOURNAL.exists() and ("--journal" in self._command or DAMAGED.exists())
        run = stopped(partial(done, "resume j" if resumed else self._command))
        return f"{left}, then {f'CODE {run.code}: {run.said}' if run.code else self._seen()}"

    def failed(self, at: int) -> str:
        """Let a call fail; return what was said and seen."""
        begin_from(self._root, "begin")
        run = stopped(partial(done, self._command), at, full=True)
        if not run.n_refused:
            return f"NOT REFUSED: CODE {run.code}"
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
    parser = argparse.ArgumentParser(description="Stop every verb at its calls that change files.")
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
        spacious = [(at, call) for at, call in attack.calls if call in SPACE]
        for at, call in attack.calls[:: arguments.every] if arguments.every else ():
            found[attack.killed(at)].append(f"{at} {call}")
        for at, call in spacious[:: arguments.full] if arguments.full else ():
            found[attack.failed(at)].append(f"{at} {call}")
        n_stopped = sum(map(len, found.values()))
        print(f"{name}: {len(attack.calls)} calls, {n_stopped} stops", flush=True)
        bad += not n_stopped
        for what, where in found.items():
            print(f"  {len(where)} times {what}: {', '.join(where[:6])}", flush=True)
            bad += not FINE.search(what)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main_())
