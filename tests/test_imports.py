"""``import relmap`` stays light, and imports inside relmap run one way."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.commands import run_process

HEAVY = {"matplotlib", "numba", "open3d", "sklearn", "typer"}
SLOW = {"scipy.optimize", "scipy.signal", "scipy.stats"}
"""Parts of libraries that are slow to load and not needed."""
LIMIT_S, NAMES_LIMIT_S = 0.3, 0.5
RUNS = 5

LIST_MODULES = "import json, sys; from relmap import *; print(json.dumps(list(sys.modules)))"

# A part is a module or package right below relmap, `ROOT` is relmap/__init__.py.  Each may import
# the parts on the right, anywhere in a function or for types alone too, and itself.
ROOT = "relmap"
MAY_IMPORT = {
    "core": set(),
    "datasets": {"core"},
    "io": {"core", "datasets"},
    "segmentation": {"core"},
    "simulation": {"core", "datasets"},
    "mapped": {"core"},
    "recorded": {"core", "io"},
    "mapper": {"core", "mapped", "recorded"},
    "points": {"core", "io", "mapper"},
    "planes": {"core", "io", "mapper", "segmentation"},
    "planes3d": {"core", "io", "recorded", "segmentation"},
    ROOT: {"core", "planes", "planes3d", "points", "segmentation"},
}
MAY_IMPORT["evaluation"] = {*MAY_IMPORT} - {"mapper"}
MAY_IMPORT["comparison"] = {*MAY_IMPORT} - {"mapper"}
MAY_IMPORT["plots"] = {*MAY_IMPORT} - {"mapper", "points", "comparison"}
MAY_IMPORT["merging"] = {*MAY_IMPORT} - {"mapper", "comparison", "plots", "exports"}
MAY_IMPORT["exports"] = {*MAY_IMPORT} - {"mapper", "comparison"}
MAY_IMPORT["figures"] = {*MAY_IMPORT} - {"mapper"}
MAY_IMPORT["cli"] = {*MAY_IMPORT}

FIGURES_FROM = {"relmap.cli.figures"}
"""The figures of the paper are made by one command; no other module may need them."""

KNOWN = {
    ("relmap.recorded", "relmap"),
}
"""Imports that break the rule today; none may be added, and fixed ones must be removed."""

FOLDERS = [
    "scans",
    "odometry",
    "linking",
    "walls",
    "submaps",
    "plan",
    "refinement",
    "places",
]
"""Folders of `relmap.planes`; each may import those before it."""

LIGHT = (
    "core",
    "datasets",
    "io",
    "mapped",
    "mapper",
    "planes",
    "planes3d",
    "points",
    "recorded",
    "segmentation",
    "simulation",
)
"""Parts whose modules load no heavy library, but for their kernels."""
KERNELS = "kernels"
"""How the names of modules end whose loops are compiled; they are imported where they are used."""
COMPILING = {
    f"relmap.core.linalg.{name}"
    for name in ("caching", "compiler", "compiling", "lowering", "resolving")
}


def run_python(code: str, env: dict[str, str], folder: Path) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    done = run_process([sys.executable, "-c", code], env=env, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_no_heavy_library(child_env: dict[str, str], tmp_path: Path) -> None:
    modules = json.loads(run_python(LIST_MODULES, child_env, tmp_path))
    assert "relmap" in modules
    assert SLOW & {*modules} == set()
    assert HEAVY & {module.partition(".")[0] for module in modules} == set()


def test_the_command_line_begins_without_numpy(child_env: dict[str, str], tmp_path: Path) -> None:
    """A usage error or help takes a tenth of a second, with numpy and scipy half a second."""
    code = "import json, sys; import relmap.cli.program; print(json.dumps(list(sys.modules)))"
    modules = json.loads(run_python(code, child_env, tmp_path))
    assert {"numpy", "scipy"} & {module.partition(".")[0] for module in modules} == set()


def test_modules_load_no_heavy_library(
    child_env: dict[str, str], repo_root: Path, tmp_path: Path
) -> None:
    """Each module of the library, imported after all the others, whatever the order."""
    names = [
        name
        for name in modules_of(repo_root)
        if part_of(name) in LIGHT and not name.endswith(KERNELS) and name not in COMPILING
    ]
    assert len(names) > 100
    code = (
        "import importlib, json, sys\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        "print(json.dumps(list(sys.modules)))"
    )
    modules = json.loads(run_python(code, child_env, tmp_path))
    assert HEAVY & {module.partition(".")[0] for module in modules} == set()


def test_import_takes_under_three_tenths_of_a_second(
    child_env: dict[str, str], tmp_path: Path
) -> None:
    """Only the best of several fresh interpreters counts; the time is that of the processor."""
    code = "from time import process_time as t; begin = t(); import relmap; print(t() - begin)"
    assert any(float(run_python(code, child_env, tmp_path)) < LIMIT_S for _ in range(RUNS))


def test_public_names_take_under_half_a_second(child_env: dict[str, str], tmp_path: Path) -> None:
    """The time is what all public names add once the numpy and scipy they use are loaded."""
    modules = json.loads(run_python(LIST_MODULES, child_env, tmp_path))
    below = [
        module
        for module in modules
        if module.partition(".")[0] in {"numpy", "scipy"} and "._" not in module
    ]
    code = (
        "import contextlib, importlib, time, warnings  # of the processor: others may be busy\n"
        "warnings.simplefilter('ignore')\n"
        f"for module in {below!r}:\n"
        "    with contextlib.suppress(ImportError): importlib.import_module(module)\n"
        "begin = time.process_time()\n"
        "from relmap import *\n"
        "print(time.process_time() - begin)\n"
    )
    assert any(float(run_python(code, child_env, tmp_path)) < NAMES_LIMIT_S for _ in range(RUNS))


@dataclass(frozen=True)
class Import:
    """An import of one module of relmap by another; `loading` if it is run when that is loaded."""

    by: str
    of: str
    loading: bool = True


def modules_of(root: Path) -> dict[str, Path]:
    """Return the files of all modules by name."""
    paths = sorted((root / "relmap").rglob("*.py"))
    names = [".".join(path.relative_to(root).with_suffix("").parts) for path in paths]
    return {name.removesuffix(".__init__"): path for name, path in zip(names, paths, strict=True)}


def part_of(module: str) -> str:
    """Return which part of relmap (``core``, ``points``, ...) a module is in."""
    part = module.split(".")[1] if "." in module else ROOT
    return "cli" if part == "__main__" else part


def names_imported(node: ast.stmt, package: str) -> list[str]:
    """Return full names of what a statement imports into a module of a package."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    parents = package.split(".")[: 1 - node.level or None] if node.level else []
    base = ".".join([*parents, *([node.module] if node.module else [])])
    return [f"{base}.{alias.name}" for alias in node.names]


def imports_of(source: str, by: str, package: str, modules: set[str]) -> set[Import]:
    """Return what of relmap a module imports, wherever in its source."""
    found = set()

    def visit(node: ast.AST, loading: bool) -> None:
        for child in ast.iter_child_nodes(node):
            now = loading and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                now = False
            if isinstance(child, ast.stmt):
                for name in names_imported(child, package):
                    of = name if name in modules else name.rpartition(".")[0]
                    if name.partition(".")[0] == ROOT:
                        found.add(Import(by, of or name, now))
            visit(child, now)

    visit(ast.parse(source), True)
    return found


@pytest.fixture(scope="module")
def imports(repo_root: Path) -> set[Import]:
    """Return every import inside relmap."""
    modules, found = modules_of(repo_root), set()
    for name, path in modules.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        found |= imports_of(path.read_text(encoding="utf-8"), name, package, {*modules})
    assert {item.by for item in found} | {item.of for item in found} <= {*modules}
    return found


MODULES = {"relmap", "relmap.core", "relmap.core.store", "relmap.planes", "relmap.plots.bench"}


@pytest.mark.parametrize(
    ("source", "of", "loading"),
    [
        ("import numpy", None, True),
        ("import relmap", "relmap", True),
        ("from relmap import __version__", "relmap", True),
        ("import relmap.plots.bench", "relmap.plots.bench", True),
        ("from relmap import planes", "relmap.planes", True),
        ("from relmap.core.store import ObservationStore", "relmap.core.store", True),
        ("def f():\n    from relmap.planes import PlaneMapper", "relmap.planes", False),
        ("class C:\n    from relmap.planes import PlaneMapper", "relmap.planes", True),
        ("if TYPE_CHECKING:\n    from relmap.planes import PlaneMapper", "relmap.planes", False),
        ("try:\n    import relmap.planes\nexcept ImportError: pass", "relmap.planes", True),
        ("from . import store", "relmap.core.store", True),
        ("from .store import ObservationStore", "relmap.core.store", True),
        ("from ..planes import PlaneMapper", "relmap.planes", True),
        ("from .. import planes", "relmap.planes", True),
    ],
)
def test_imports_are_found(source: str, of: str | None, loading: bool) -> None:
    found = imports_of(source, "relmap.core.own", "relmap.core", MODULES)
    assert found == ({Import("relmap.core.own", of, loading)} if of else set())


def allowed(item: Import) -> bool:
    """Return whether an import runs the right way."""
    by, of = part_of(item.by), part_of(item.of)
    if of == "figures" and by == "cli" and item.by not in FIGURES_FROM:
        return False
    return of == by or of in MAY_IMPORT[by]


def test_imports_run_one_way(imports: set[Import]) -> None:
    wrong = {(item.by, item.of) for item in imports if not allowed(item)}
    assert wrong - KNOWN == set(), "these imports run the wrong way"
    assert KNOWN - wrong == set(), "these are mended: take them out of the table"


def test_the_folders_of_planes_import_one_way(imports: set[Import], repo_root: Path) -> None:
    """Each imports only those that ARCHITECTURE.md lists above it."""
    names = {path.name for path in (repo_root / "relmap" / "planes").iterdir() if path.is_dir()}
    assert names - {"__pycache__"} == {*FOLDERS}
    wrong = set()
    for item in imports:
        by, of = (name.removeprefix("relmap.planes.").split(".")[0] for name in (item.by, item.of))
        if by in FOLDERS and of in FOLDERS and FOLDERS.index(of) > FOLDERS.index(by):
            wrong.add((item.by, item.of))
    assert wrong == set()


@pytest.mark.parametrize(
    "folder", ["relmap.core.association.reobservation", "relmap.core.refinement.chain"]
)
def test_modules_beside_a_folder_of_the_core_do_not_import_it(
    imports: set[Import], folder: str
) -> None:
    """What registers a scan needs no map, and refinement no odometry."""
    inside = {item.by for item in imports if item.by.startswith(f"{folder}.")}
    assert inside
    beside = folder.rpartition(".")[0]
    wrong = {
        (item.by, item.of)
        for item in imports
        if item.by.rpartition(".")[0] == beside and item.of.startswith(f"{folder}.")
    }
    assert wrong == set()


def test_rules_hold_every_part_and_let_none_import_itself(repo_root: Path) -> None:
    assert {part_of(name) for name in modules_of(repo_root)} == {*MAY_IMPORT}
    assert "figures" in MAY_IMPORT["cli"]
    assert {by for by, parts in MAY_IMPORT.items() if "figures" in parts} == {"cli"}
    assert "plots" in MAY_IMPORT["figures"]
    assert not any("cli" in parts for parts in MAY_IMPORT.values())
    order = list(TopologicalSorter(MAY_IMPORT).static_order())  # raises where there is a cycle
    assert (order[0], order[-1]) == ("core", "cli")


def test_no_modules_import_each_other_when_loaded(imports: set[Import]) -> None:
    needs: dict[str, set[str]] = {}
    for item in imports:
        if item.loading and item.by != item.of:
            needs.setdefault(item.by, set()).add(item.of)
    TopologicalSorter(needs).prepare()  # raises CycleError, which names the cycle
