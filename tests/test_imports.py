"""``import relmap`` stays light, and imports inside relmap run one way."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {"matplotlib", "open3d", "sklearn"}
LIMIT_S = 0.5
RUNS = 5

LIST_MODULES = "import json, sys, relmap; print(json.dumps(list(sys.modules)))"

# What stands on the left imports nothing from the parts of relmap on the right; core, which all
# else is built on, imports nothing of relmap but itself.
ABOVE = {"cli", "evaluation", "figures", "plots"}
FORBIDDEN = {
    "datasets": ABOVE,
    "planes": ABOVE,
    "points": ABOVE,
    "segmentation": ABOVE | {"planes", "points"},
    "simulation": ABOVE,
}


def run_python(code: str, env: dict[str, str], folder: Path) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=env,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_no_heavy_library(child_env: dict[str, str], tmp_path: Path) -> None:
    modules = json.loads(run_python(LIST_MODULES, child_env, tmp_path))
    assert "relmap" in modules
    assert HEAVY & {module.partition(".")[0] for module in modules} == set()


def test_import_takes_under_half_a_second(child_env: dict[str, str], tmp_path: Path) -> None:
    """The time is what ``import relmap`` adds once the numpy and scipy it uses are loaded.

    Only the best of several fresh interpreters counts: anything else the machine does can make
    an import slower, never faster.
    """
    modules = json.loads(run_python(LIST_MODULES, child_env, tmp_path))
    below = [
        module
        for module in modules
        if module.partition(".")[0] in {"numpy", "scipy"} and "._" not in module
    ]
    code = (
        "import contextlib, importlib, time, warnings\n"
        "warnings.simplefilter('ignore')\n"
        f"for module in {below!r}:\n"
        "    with contextlib.suppress(ImportError): importlib.import_module(module)\n"
        "begin = time.perf_counter()\n"
        "import relmap\n"
        "print(time.perf_counter() - begin)\n"
    )
    best = min(float(run_python(code, child_env, tmp_path)) for _ in range(RUNS))
    assert best < LIMIT_S


def imported_parts(source: str, package: str) -> set[str]:
    """Return which parts of relmap (``core``, ``points``, ...) a module of ``package`` imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: 1 - node.level or None] if node.level else []
            base = ".".join([*parents, *([node.module] if node.module else [])])
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return {name.split(".")[1] for name in names if name.startswith("relmap.")}


@pytest.mark.parametrize(
    ("source", "package", "parts"),
    [
        ("import numpy", "relmap.core", set()),
        ("import relmap.plots.figures", "relmap.core", {"plots"}),
        ("from relmap import planes", "relmap.core", {"planes"}),
        ("def f():\n    from relmap.points.mapper import PointMapper", "relmap.core", {"points"}),
        ("from . import store", "relmap.core", {"core"}),
        ("from .store import ObservationStore", "relmap.core", {"core"}),
        ("from ..planes import PlaneMapper", "relmap.core", {"planes"}),
        ("from .. import plots", "relmap.core", {"plots"}),
    ],
)
def test_imported_parts(source: str, package: str, parts: set[str]) -> None:
    assert imported_parts(source, package) == parts


@pytest.mark.parametrize("part", ["core", *FORBIDDEN])
def test_imports_run_one_way(part: str, repo_root: Path) -> None:
    wrong = []
    for path in sorted((repo_root / "relmap" / part).rglob("*.py")):
        relative = path.relative_to(repo_root)
        package = ".".join(relative.parent.parts)
        found = imported_parts(path.read_text(encoding="utf-8"), package)
        bad = found - {"core"} if part == "core" else found & FORBIDDEN[part]
        wrong += [f"{relative} imports relmap.{other}" for other in sorted(bad)]
    assert not wrong
