"""What every test shares: hypothesis profiles, the real data, an environment for subprocesses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import relmap

os.environ["MPLBACKEND"] = "Agg"

ROOT = Path(__file__).resolve().parents[1]

# No deadline and no limit on slow generation: the machine may be busy, the answer is the same.
for name, derandomize in (("dev", False), ("ci", True)):
    settings.register_profile(
        name,
        deadline=None,
        derandomize=derandomize,
        print_blob=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") == "true" else "dev")
)


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """Return the root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real data sets.

    It is ``RELMAP_DATA`` where that is set, else ``../shared/data`` beside the checkout.  A test
    that asks for it is skipped where it is missing, and fails where ``CI`` is ``true``.
    """
    named = os.environ.get("RELMAP_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if folder.is_dir():
        return folder
    message = f"no real data: {folder} is not a folder; set RELMAP_DATA to where the data sets are"
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def child_env() -> dict[str, str]:
    """Return an environment in which a subprocess imports the relmap that is under test here."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPATH": str(Path(relmap.__file__).resolve().parents[1])}
