"""Docstrings of what the document of Python names: parameters, results and errors."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import relmap
from relmap.datasets import log_of_frame, open_log, open_scans
from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import truth_of
from relmap.segmentation.space import PatchSegmenter, level_scan
from relmap.simulation import (
    building_scene,
    simulate_building,
    simulate_figure_eight,
    simulate_world,
)
from relmap.simulation.storey import simulate_storey

OTHERS: tuple[Any, ...] = (
    open_log,
    open_scans,
    log_of_frame,
    evaluate,
    run_mapper,
    truth_of,
    level_scan,
    PatchSegmenter,
    building_scene,
    simulate_building,
    simulate_figure_eight,
    simulate_world,
    simulate_storey,
    relmap.map_log,
)


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    public = [getattr(relmap, name) for name in relmap.__all__ if not name.startswith("_")]
    for each in (*public, *OTHERS):
        if inspect.isfunction(each):
            yield each.__qualname__, each
        elif not issubclass(each, Exception):
            for name in filter(lambda name: not name.startswith("_"), dir(each)):
                method = inspect.unwrap(getattr(each, name))
                function = getattr(method, "__func__", method)
                if inspect.isfunction(function) and function.__module__.startswith("relmap"):
                    yield f"{each.__name__}.{name}", function


@pytest.mark.parametrize(("name", "function"), [*functions()])
def test_a_docstring_explains_parameters_results_and_errors(
    name: str, function: Callable[..., Any]
) -> None:
    text, signature = inspect.getdoc(function) or "", inspect.signature(function)
    sections = {*re.findall(r"^(\w+)\n-+$", text, re.MULTILINE)}
    described = {
        word.strip("*")
        for words in re.findall(r"^([\w*, ]+?)(?: :.*)?$", text, re.MULTILINE)
        for word in words.split(", ")
    }
    missing = {*signature.parameters} - {"self", "cls"} - described
    assert not missing, f"{name} does not explain {missing}"
    returns = str(signature.return_annotation)
    assert returns in {"None", "Self"} or sections & {"Returns", "Yields"}, name
    assert "raise RelmapError" not in inspect.getsource(function) or "Raises" in sections, name
