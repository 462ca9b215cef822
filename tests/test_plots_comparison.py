"""The pictures of comparisons, sweeps and errors."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from relmap.evaluation.landmarks import Overlay
from relmap.plots.comparison import (
    SweepRow,
    plot_comparison,
    plot_errors,
    plot_sweep,
    shared_scale,
)
from relmap.plots.run import plot_run
from relmap.plots.sheet import write_png
from tests.somerun import make_result


def test_figures_of_a_comparison_are_dots() -> None:
    rows: list[tuple[str, dict[str, float | None]]]
    rows = [("relmap-points", {"ate_m": 0.1, "total_s": 2.0}), ("batch", {"ate_m": None})]
    figure = plot_comparison(rows, "two methods")
    assert not any(axes.patches for axes in figure.axes)
    (dot,) = figure.axes[0].get_lines()
    assert np.asarray(dot.get_xdata()).tolist() == [0.1]
    assert "no figure" in [text.get_text() for text in figure.axes[0].texts]


@pytest.mark.parametrize("name", ["a$\\q$ b", "x_{1}^$\\frac$", "%s{}\\n", "<b>&\"'"])
def test_names_are_shown_as_they_are_whatever_is_in_them(name: str) -> None:
    figures: dict[str, float | None] = {"ate_m": 0.1}
    for figure in (
        plot_comparison([("batch", figures)], name),
        plot_run(make_result(3), title=name),
    ):
        figure.savefig(io.BytesIO(), format="png")
        titles = [text for text in figure.findobj(Text) if text.get_text() == name]
        assert len(titles) == 1
        assert not titles[0].get_parse_math()


def test_axes_of_a_comparison_have_numbers_however_near_its_figures_are() -> None:
    for values in ((1.91, 1.95), (0.0146, 0.0984), (0.003, 0.15)):
        rows: list[tuple[str, dict[str, float | None]]]
        rows = [(f"method {value}", {"ate_m": value}) for value in values]
        axes = plot_comparison(rows, "two methods").axes[0]
        low, high = axes.get_xlim()
        shown = [at for at in axes.get_xticks() if low <= at <= high]
        assert shown
        written = [axes.xaxis.get_major_formatter()(at) for at in shown]
        assert [float(text) for text in written] == pytest.approx(shown)


def sweep_rows(numbers: bool) -> list[SweepRow]:
    return [
        SweepRow(name, at if numbers else None, {"ate_m": factor * at * (1 + 0.1 * seed)})
        for name, factor in (("relmap", 1.0), ("batch", 2.0))
        for at in (0.1, 0.2, 0.4)
        for seed in (-1, 0, 1)
    ]


def test_a_sweep_is_a_line_of_medians_for_each_method() -> None:
    axes, *others = plot_sweep(sweep_rows(True), "noise [m]").axes
    assert others == []
    assert axes.get_xlabel() == "noise [m]"
    lines = {str(line.get_label()): np.array(line.get_data()).T for line in axes.get_lines()}
    np.testing.assert_allclose(lines["relmap"], [[0.1, 0.1], [0.2, 0.2], [0.4, 0.4]])
    np.testing.assert_allclose(lines["batch"], [[0.1, 0.2], [0.2, 0.4], [0.4, 0.8]])


def test_the_errors_of_a_sweep_from_no_noise_on_can_be_read() -> None:
    rows = [SweepRow("relmap", at, {"ate_m": max(at, 1e-14)}) for at in (0.0, 0.02, 0.1)]
    axes = plot_sweep(rows, "noise [m]").axes[0]
    low, high = axes.get_ylim()
    assert sum(low <= at <= high for at in axes.get_yticks()) >= 3


def test_a_sweep_without_numbers_is_a_comparison_of_medians() -> None:
    axes = plot_sweep(sweep_rows(False), "").axes[0]
    dots = [float(np.asarray(line.get_xdata())[0]) for line in axes.get_lines()]
    assert dots == [0.2, 0.4]


@pytest.mark.parametrize("figures", [{}, {"ate_m": None}])
def test_an_empty_sweep_is_still_a_picture(
    tmp_path: Path, figures: dict[str, float | None]
) -> None:
    write_png(tmp_path / "a.png", plot_sweep, [SweepRow("relmap", 0.1, figures)], "noise [m]")
    write_png(tmp_path / "b.png", plot_sweep, [SweepRow("relmap", None, figures)], "")


def errors_of(off_m: float) -> Overlay:
    true = np.random.default_rng(0).uniform(-5, 5, (20, 3))
    pairs = np.stack([true + np.array([off_m, 0.0, 0.0]), true], axis=1)
    return Overlay(true, np.empty((0, 3)), pairs)


def test_errors_are_enlarged_alike_and_far_ones_cut() -> None:
    near, far = errors_of(0.01), errors_of(3.0)
    scale = shared_scale([near, near, far])
    assert scale == 20.0
    result = make_result(20, True)
    for overlay, label in ((near, "error, x 20"), (far, "more than 0.06 m")):
        (axes,) = plot_errors(result, overlay, scale, "a").axes
        (quiver,) = (c for c in axes.collections if isinstance(c, Quiver))
        lengths = np.hypot(quiver.U, quiver.V)
        assert lengths.max() < 0.13 * np.ptp(overlay.landmarks_map, axis=0).max()
        assert label in [line.get_label() for line in axes.get_lines()]
    np.testing.assert_allclose(lengths, lengths[0])


def test_arrows_end_inside_of_the_picture() -> None:
    result = make_result(20, True)
    still = replace(result, poses=result.poses[10:11], stamps_s=result.stamps_s[:1])
    (axes,) = plot_errors(still, errors_of(3.0), 20.0, "a").axes
    (quiver,) = (c for c in axes.collections if isinstance(c, Quiver))
    tips = quiver.XY + np.column_stack([quiver.U, quiver.V])
    assert tips[:, 0].max() < axes.get_xlim()[1]


def test_without_errors_nothing_is_enlarged() -> None:
    nothing = Overlay(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2, 3)))
    assert shared_scale([]) == shared_scale([nothing]) == 1.0
    assert shared_scale([errors_of(0.0)]) == 1.0
    for planar in (True, False):
        plot_errors(make_result(3, planar), nothing, 1.0, "a").draw_without_rendering()
