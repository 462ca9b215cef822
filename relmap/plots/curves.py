"""How the work grows: with what moves, over a loop, with what is visible (Figs 12, 14, 15)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.plots.paper import BLUE, GREY, ORANGE, RED, blank, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MACHINE = "(milliseconds of one machine: compare ratios)"
BEGINNING = 25
"""Iterations in which a map begins; left out where the end of a loop is held against its start."""
HALF_WINDOW = 25
"""Iterations before and after that a running median or mean takes in."""
FLAT = 1.2
"""Growth of the time per visible landmark that still counts as none."""
MANY = 100.0
"""So many landmarks are visible where the growth of the run time is read off."""


@dataclass(frozen=True, eq=False)
class Comparisons:
    """What sorting landmarks into static and dynamic ones took, and whether it came out right.

    Attributes
    ----------
    n : (k,) int64, ascending
        Landmarks of a block.
    dynamic : (s,) float64, ascending
        Share of them that move, in [0, 1].
    comparisons : (s, k, r) int64
        Pairs of landmarks compared, in r random worlds.
    right : (s, k, r) bool
        Whether the static bin holds what it should.
    """

    n: NDArray[np.int64]
    dynamic: NDArray[np.float64]
    comparisons: NDArray[np.int64]
    right: NDArray[np.bool_]

    @property
    def median(self) -> NDArray[np.float64]:
        """Comparisons in the middle one of the worlds; (s, k)."""
        return np.asarray(np.median(self.comparisons, axis=2))

    @property
    def within_n_log_n(self) -> int:
        """How many of the shares, from the smallest on, have no median above n log2 n."""
        within = np.all(self.median <= n_log_n(self.n), axis=1)
        return int(np.logical_and.accumulate(within).sum())


@dataclass(frozen=True, eq=False)
class LoopTiming:
    """One loop, iteration by iteration.

    Attributes
    ----------
    time_ms : (i,) float64
        Processor time.
    visible : (i,) int64
        Landmarks in the scan.
    landmarks, true_landmarks : (i,) int64
        Landmarks seen so far: as the mapper tells them apart, and truly.
    """

    time_ms: NDArray[np.float64]
    visible: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    true_landmarks: NDArray[np.int64]

    @property
    def growth_each(self) -> tuple[float, float]:
        """By what factor median and mean time per visible landmark change over the loop."""
        each_ms = self.time_ms / np.maximum(self.visible, 1)
        return growth(each_ms), growth(each_ms, np.mean)

    @property
    def said(self) -> str:
        """How the last quarter of the loop compares with the first, in ratios."""
        median, mean = self.growth_each
        flat = "not flat" if median > FLAT else "flat in the median, not in the mean"
        return (
            f"{'flat' if max(median, mean) <= FLAT else flat}: last quarter to first (from "
            f"{BEGINNING} on), landmarks x {growth(self.landmarks):.1f},\n"
            f"median time x {growth(self.time_ms):.2f} (per visible landmark x {median:.2f}), "
            f"mean x {growth(self.time_ms, np.mean):.2f} (x {mean:.2f})"
        )


@dataclass(frozen=True, eq=False)
class DensityTiming:
    """Processor time per iteration in worlds of different density.

    Attributes
    ----------
    visible : (k,) float64, ascending
        Average number of landmarks in a scan.
    median_ms, mean_ms : (k,) float64
    """

    visible: NDArray[np.float64]
    median_ms: NDArray[np.float64]
    mean_ms: NDArray[np.float64]

    @property
    def first(self) -> int:
        """Where growth is read off from: the first with `MANY` visible, two being there to grow."""
        return min(int(np.searchsorted(self.visible, MANY)), max(len(self.visible) - 2, 0))

    @property
    def growth(self) -> tuple[float, float, float]:
        """By what factor n log n, the median and the mean grow from `first` to the last."""
        kinds = (n_log_n(self.visible), self.median_ms, self.mean_ms)
        bound, median, mean = (float(values[-1] / values[self.first]) for values in kinds)
        return bound, median, mean

    @property
    def said(self) -> str:
        """How the times grow from `MANY` visible landmarks on, beside n log n, in ratios."""
        bound, median, mean = self.growth
        verdict = "within" if max(median, mean) <= bound else "more than"
        return (
            f"{verdict} n log n: from {self.visible[self.first]:.0f} to {self.visible[-1]:.0f} "
            f"visible, n log n x {bound:.1f}, median time x {median:.1f}, mean x {mean:.1f}"
        )


def growth(values: NDArray[Any], of: Any = np.median) -> float:
    """Return by what factor the median, or `of`, of values (i,) changes, first to last quarter.

    The first `BEGINNING` iterations do not count.
    """
    quarter = max(len(values) // 4, 1)
    begin = min(BEGINNING, len(values) - quarter)
    return float(of(values[-quarter:]) / of(values[begin : begin + quarter]))


def n_log_n(n: NDArray[Any]) -> NDArray[np.float64]:
    """Return n log2 n."""
    return np.asarray(n * np.log2(n), dtype=np.float64)


def fit_n_log_n(n: NDArray[np.float64], time_ms: NDArray[np.float64]) -> tuple[float, float]:
    """Fit ``a + b n log2 n``, neither negative, by least squares of the relative errors.

    Parameters
    ----------
    n, time_ms : (k,) float64

    Returns
    -------
    a, b : float
        Milliseconds.
    """
    from scipy.optimize import nnls

    terms = np.column_stack([np.ones(len(n)), n_log_n(n)])
    a, b = nnls(terms / time_ms[:, None], np.ones(len(n)))[0]
    return float(a), float(b)


def running(values: NDArray[np.float64], of: Any) -> NDArray[np.float64]:
    """Return `of`, ``numpy.median`` or such, of the values (i,) around each one; (i,)."""
    return np.array(
        [of(values[max(k - HALF_WINDOW, 0) : k + HALF_WINDOW + 1]) for k in range(len(values))]
    )


def plot_comparisons(data: Comparisons) -> Figure:
    """Draw the comparisons over the number of landmarks, and how often it goes well (Fig. 12)."""
    figure = blank(11.5, 5.2)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_comparisons(left, data)
    _draw_right(right, data)
    return figure


def _draw_comparisons(axes: Axes, data: Comparisons) -> None:
    import matplotlib as mpl

    shares = len(data.dynamic)
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.92, shares))
    n = data.n.astype(np.float64)
    axes.plot(n, n**2, ":", color=GREY, linewidth=1.6, label=r"$n^2$")
    axes.plot(n, n_log_n(n), "--", color="black", linewidth=1.6, label=r"$n\,\log_2 n$")
    sizes = np.linspace(9, 2.5, shares)  # where lines coincide, all of them show
    kinds = zip(data.dynamic, data.median, colours, sizes, strict=True)
    for share, median, colour, size in kinds:
        style = {"color": colour, "markersize": size, "linewidth": 1.3}
        axes.plot(n, median, "o-", label=f"{100 * share:.0f} % dynamic", **style)
    axes.set(xscale="log", yscale="log", ylim=(n[0], 3 * n_log_n(n[-1:])[0]))
    _write_in_full(axes.xaxis, n)
    title = f"Figure 12: comparisons, median of {data.right.shape[2]} worlds\n{_held(data)}"
    finish(axes, title, "landmarks n", "comparisons of two landmarks")
    axes.legend(fontsize=8, loc="lower right")


def _held(data: Comparisons) -> str:
    """Say how far the number of comparisons stays within n log2 n."""
    held = data.within_n_log_n
    if held == 0:
        return "more than n log₂ n for every share"
    said = f"at or below n log₂ n up to {100 * data.dynamic[held - 1]:.0f} % dynamic"
    return said if held == len(data.dynamic) else f"{said}; beyond, the search is cut off there"


def _draw_right(axes: Axes, data: Comparisons) -> None:
    """Write how often the static bin is right, with the number of landmarks across."""
    share = data.right.mean(axis=2)
    axes.imshow(share, cmap="RdYlGn", vmin=0, vmax=1, aspect="auto", origin="lower", alpha=0.7)
    for row, column in np.ndindex(share.shape):
        text = f"{100 * share[row, column]:.0f}"
        axes.text(column, row, text, ha="center", va="center", fontsize=9)
    title = "worlds whose static bin is right [%],\nnothing mapped before, 2 % misplaced at most"
    finish(axes, title, "landmarks n", "share of them that is dynamic")
    axes.grid(visible=False)
    axes.set_xticks(range(len(data.n)), data.n.tolist())
    axes.set_yticks(range(len(data.dynamic)), [f"{100 * part:.0f} %" for part in data.dynamic])


def plot_loop_timing(data: LoopTiming) -> Figure:
    """Draw the time of each iteration of a loop above the number of landmarks (Fig. 14)."""
    figure = blank(9.2, 6.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1.0])
    i = np.arange(len(data.time_ms))
    dots: dict[str, Any] = {"markersize": 2, "linestyle": "", "color": "#b5b5b5"}
    above.plot(i, data.time_ms, "o", label="one iteration", **dots)
    for of, name, colour in ((np.mean, "mean", ORANGE), (np.median, "median", BLUE)):
        label = f"running {name}, {2 * HALF_WINDOW + 1} iterations"
        above.plot(i, running(data.time_ms, of), color=colour, linewidth=1.8, label=label)
    lowest, highest = float(data.time_ms.min()), float(data.time_ms.max())
    above.set(yscale="log", ylim=(lowest / 1.5, 2.5 * highest))
    _write_in_full(above.yaxis, data.time_ms)
    title = f"Figure 14: run time over one loop {MACHINE}\n{data.said}"
    finish(above, title, "", "processor time of an iteration [ms]")
    above.legend(fontsize=8, loc="upper center", ncols=3)
    below.plot(i, data.landmarks, color=BLUE, label="landmarks known, as relmap tells them apart")
    below.plot(i, data.true_landmarks, "--", color=RED, label="true landmarks seen so far")
    below.plot(i, data.visible, color=GREY, linewidth=1.0, label="visible in the iteration")
    finish(below, "", "iteration", "number of landmarks")
    below.set_ylim(0, 1.1 * float(data.landmarks.max()))
    below.legend(fontsize=8, loc="upper left")
    return figure


def plot_density_timing(data: DensityTiming) -> Figure:
    """Draw the time of an iteration over the number of visible landmarks (Fig. 15)."""
    figure = blank(7.8, 5.8)
    axes = figure.subplots()
    n = np.geomspace(data.visible[0], data.visible[-1], 200)
    kinds = (("mean", data.mean_ms, ORANGE, "s"), ("median", data.median_ms, BLUE, "o"))
    for name, times, colour, marker in kinds:
        a, b = fit_n_log_n(data.visible, times)
        axes.plot(data.visible, times, marker, color=colour, label=f"{name} of the iterations")
        label = f"fit: {a:.2f} ms + {1e6 * b:.0f} ns × n log₂ n"
        axes.plot(n, a + b * n_log_n(n), "--", color=colour, linewidth=1.0, label=label)
    bound = n_log_n(n) * data.mean_ms[-1] / n_log_n(n[-1:])
    axes.plot(n, bound, ":", color=GREY, linewidth=1.6, label="slope of n log₂ n alone")
    axes.set(xscale="log", yscale="log", ylim=(data.median_ms.min() / 2, 2 * data.mean_ms.max()))
    _write_in_full(axes.xaxis, data.visible)
    _write_in_full(axes.yaxis, np.concatenate([data.median_ms, data.mean_ms]))
    title = f"Figure 15: run time over what is visible {MACHINE}\n{data.said}"
    finish(axes, title, "landmarks visible n, on average", "processor time of an iteration [ms]")
    axes.legend(fontsize=8, loc="upper left")
    return figure


def _write_in_full(axis: Any, values: NDArray[np.float64]) -> None:
    """Write the numbers of a logarithmic axis as 1, 2, 5, 10, ..."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    steps = np.outer(10.0 ** np.arange(-6, 9), [1, 2, 5]).ravel()
    shown = steps[(steps >= values.min() / 1.7) & (steps <= values.max() * 1.7)]
    axis.set_major_locator(FixedLocator(shown.tolist()))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
