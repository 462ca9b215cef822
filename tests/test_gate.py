"""The benchmark gate distinguishes better from worse; nothing is measured here."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def gate(repo_root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("gate", repo_root / "benchmarks" / "gate.py")
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["gate"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("value", "better", "worse"),
    [
        (1.09, "lower", False),
        (1.11, "lower", True),
        (0.5, "lower", False),
        (0.91, "higher", False),
        (0.89, "higher", True),
        (2.0, "higher", False),
        (float("nan"), "higher", True),
        (float("nan"), "lower", True),
    ],
)
def test_direction_and_tolerance(gate: ModuleType, value: float, better: str, worse: bool) -> None:
    assert gate.is_worse(value, 1.0, better, 0.1) == worse


def test_baseline_has_every_metric(gate: ModuleType) -> None:
    baseline = json.loads(gate.BASELINE.read_text())
    assert list(baseline) == [metric.name for metric in gate.METRICS]
    for metric in gate.METRICS:
        assert baseline[metric.name]["better"] == metric.better
        assert baseline[metric.name]["tolerance"] == metric.tolerance


def test_exit_code(
    gate: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline = json.loads(gate.BASELINE.read_text())
    found = {name: told["value"] for name, told in baseline.items()}
    fakes = [
        gate.Metric(m.name, m.better, m.tolerance, lambda name=m.name: found[name])
        for m in gate.METRICS
    ]
    monkeypatch.setattr(gate, "METRICS", fakes)
    monkeypatch.setattr("sys.argv", ["gate.py"])
    assert gate.main() == 0
    assert "WORSE" not in capsys.readouterr().out
    found[fakes[0].name] *= 2
    assert gate.main() == 1
    printed = capsys.readouterr()
    assert printed.out.count("WORSE") == 1
    assert fakes[0].name in printed.err
