"""Wheel and sdist hold exactly the package, with and without the links in the root."""

from __future__ import annotations

import configparser
import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.commands import run_process

LINKS = ("planes", "points", "segmentation")
DIST_INFO = {
    "METADATA",
    "RECORD",
    "WHEEL",
    "entry_points.txt",
    "licenses/LICENSE",
    "top_level.txt",
}
BESIDE_THE_PACKAGE = {
    "LICENSE",
    "MANIFEST.in",
    "PKG-INFO",
    "README.md",
    "pyproject.toml",
    "setup.cfg",
    "relmap.egg-info/PKG-INFO",
    "relmap.egg-info/SOURCES.txt",
    "relmap.egg-info/dependency_links.txt",
    "relmap.egg-info/entry_points.txt",
    "relmap.egg-info/requires.txt",
    "relmap.egg-info/top_level.txt",
}


@dataclass(frozen=True)
class Built:
    """A clean copy of the sources and what was built from it."""

    source: Path
    wheel: Path
    sdist: Path

    def package(self) -> set[str]:
        """Return every file of the package in the sources."""
        folder = self.source / "relmap"
        return {
            path.relative_to(self.source).as_posix() for path in folder.rglob("*") if path.is_file()
        }


def source_files(root: Path) -> list[str] | None:
    """Return the files git knows or would add; None where git cannot tell."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    names = [name for name in listed.stdout.split("\0") if name]
    return names if "pyproject.toml" in names else None


def leftovers(root: Path) -> Callable[[str, list[str]], set[str]]:
    """Return the function by which shutil.copytree leaves out what are not sources."""
    at_root = shutil.ignore_patterns(".git", ".venv*", "build", "dist", "relmap-demo", ".*_cache")
    anywhere = shutil.ignore_patterns("*.egg-info", "__pycache__", ".hypothesis")

    def ignore(folder: str, names: list[str]) -> set[str]:
        found = anywhere(folder, names)
        return found | at_root(folder, names) if Path(folder) == root else found

    return ignore


def copy_sources(root: Path, target: Path) -> None:
    """Copy the sources without what builds and runs leave behind."""
    names = source_files(root)
    if names is None:
        shutil.copytree(root, target, symlinks=True, ignore=leftovers(root))
        return
    for name in names:
        if os.path.lexists(root / name):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, target / name, follow_symlinks=False)


def unlink_root(source: Path) -> None:
    """Leave the root as a checkout without symbolic links has it: the links are text files."""
    for name in LINKS:
        (source / name).unlink()
        (source / name).write_text(f"relmap/{name}", encoding="utf-8")


@pytest.fixture(scope="module", params=["links", "no links"])
def built(
    request: pytest.FixtureRequest, repo_root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Built:
    """Build the sdist from a clean copy, and the wheel from the sdist."""
    folder = tmp_path_factory.mktemp("packaging")
    source, out = folder / "source", folder / "dist"
    copy_sources(repo_root, source)
    if request.param == "no links":
        unlink_root(source)
    before = {path for path in source.rglob("*") if path.is_file()}
    done = run_process(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(source)]
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    for path in {path for path in source.rglob("*") if path.is_file()} - before:
        path.unlink()
    (wheel,), (sdist,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return Built(source, wheel, sdist)


def project(root: Path) -> dict[str, object]:
    """Return the table ``project`` of pyproject.toml."""
    table = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert isinstance(table, dict)
    return table


def test_wheel_holds_exactly_the_package(built: Built, repo_root: Path) -> None:
    info = f"relmap-{project(repo_root)['version']}.dist-info"
    with zipfile.ZipFile(built.wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
    assert len(names) == len(set(names))
    assert "relmap/py.typed" in names
    assert set(names) == built.package() | {f"{info}/{name}" for name in DIST_INFO}


def test_sdist_holds_exactly_the_package(built: Built, repo_root: Path) -> None:
    top = f"relmap-{project(repo_root)['version']}/"
    with tarfile.open(built.sdist) as archive:
        members = [member for member in archive.getmembers() if not member.isdir()]
    assert all(member.isfile() and member.name.startswith(top) for member in members)
    names = [member.name.removeprefix(top) for member in members]
    assert len(names) == len(set(names))
    assert set(names) == built.package() | BESIDE_THE_PACKAGE


def test_wheel_metadata_agrees_with_pyproject(built: Built, repo_root: Path) -> None:
    table = project(repo_root)
    info = f"relmap-{table['version']}.dist-info"
    with zipfile.ZipFile(built.wheel) as archive:
        metadata = email.message_from_bytes(archive.read(f"{info}/METADATA"))
        scripts = configparser.ConfigParser()
        scripts.read_string(archive.read(f"{info}/entry_points.txt").decode())
    assert metadata["Name"] == "relmap"
    assert metadata["License-Expression"] == "MIT"
    assert metadata["Requires-Python"] == ">=3.11"
    assert {key: dict(scripts[key]) for key in scripts.sections()} == {
        "console_scripts": {"relmap": "relmap.cli:main"}
    }


def test_wheel_runs(built: Built, child_env: dict[str, str], tmp_path: Path) -> None:
    """The command line starts from nothing but what the wheel holds."""
    site = tmp_path / "site"
    with zipfile.ZipFile(built.wheel) as archive:
        archive.extractall(site)
    code = "import relmap, relmap.cli; assert callable(relmap.cli.main); print(relmap.__file__)"
    done = run_process(
        [sys.executable, "-c", code], env=child_env | {"PYTHONPATH": str(site)}, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()) == site / "relmap" / "__init__.py"


@pytest.mark.parametrize("name", LINKS)
def test_root_link_leads_into_the_package(name: str, repo_root: Path) -> None:
    link = repo_root / name
    if link.is_symlink():
        assert link.readlink() == Path("relmap", name)
        assert link.resolve() == repo_root / "relmap" / name
    else:  # git checks links out as text files where the file system has none
        assert link.read_text(encoding="utf-8").strip() == f"relmap/{name}"
    assert (repo_root / "relmap" / name).is_dir()


def test_citation_names_the_version(repo_root: Path) -> None:
    citation = (repo_root / "CITATION.cff").read_text(encoding="utf-8")
    found = re.search(r"^version: (\S+)$", citation, flags=re.MULTILINE)
    assert found[1] == project(repo_root)["version"]
