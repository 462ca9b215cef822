"""Figure 12: number of comparisons to find moving landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.dynamics import binned
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged, n_log_n
from relmap.plots.sheet import GREY, blank, finish, write_in_full
from relmap.simulation import simulate_figure_eight

SIGMA_M = 0.05
BLOCK = 30
"""Iterations in which the landmarks are seen."""
MISPLACED = 0.02
"""Largest fraction of landmarks misplaced by a correct static bin."""
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
PAPERS_SHARE = 0.4
"""Fraction of moving landmarks up to which the paper needs no more than n log n comparisons."""
FULL: tuple[tuple[int, ...], int] = ((20, 30, 50, 80, 130, 200, 320, 500, 800), 40)
QUICK: tuple[tuple[int, ...], int] = ((20, 50, 130, 320, 800), 6)
"""Sizes of blocks, and number of worlds."""
OFTEN = 0.95


@dataclass(frozen=True, eq=False)
class Comparisons:
    """Comparisons to sort landmarks into static and dynamic ones, and whether the result is right.

    `n` (k,), ascending: landmarks of a block; `dynamic` (s,), ascending: fraction of them that
    move, in [0, 1]; `comparisons` (s, k, r): pairs of landmarks compared, in r random worlds;
    `right` (s, k, r): whether the static bin is correct.
    """

    n: Ints
    dynamic: Floats
    comparisons: Ints
    right: Bools

    @property
    def median(self) -> Floats:
        """Median comparisons over the worlds; (s, k)."""
        return np.asarray(np.median(self.comparisons, axis=2))

    @property
    def within_n_log_n(self) -> int:
        """Number of shares, from the smallest on, without a median above n log2 n."""
        within = np.all(self.median <= n_log_n(self.n), axis=1)
        return int(np.logical_and.accumulate(within).sum())


def sorted_worlds(sizes: tuple[int, ...], worlds: int, watch: Watch = iter) -> Comparisons:
    """Sort blocks of all sizes, with all fractions of moving landmarks, in each world.

    `sizes`, ascending: landmarks of a block; `worlds`: number of worlds, with seeds from 0;
    `watch`: wraps the seeds, to show progress.
    """
    shape = (len(SHARES), len(sizes), worlds)
    counts, right = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    for seed in watch(range(worlds)):
        pool, static = observed_places(seed, sizes[-1])
        for s, k in np.ndindex(shape[:2]):
            n = sizes[k]
            block, at_rest = block_of(n, SHARES[s], pool, static, seed)
            bins = binned(block, SIGMA_M, np.zeros(n))
            misplaced = np.sum(np.isin(np.arange(n), bins.static) != at_rest)
            counts[s, k, seed] = bins.n_comparisons
            right[s, k, seed] = misplaced <= max(1, MISPLACED * n)
    return Comparisons(np.array(sizes), np.array(SHARES), counts, right)


def _judge(data: Comparisons) -> Outcome:
    few = data.dynamic <= PAPERS_SHARE + 1e-9
    ratios = (data.median / n_log_n(data.n)).max(axis=1)
    often = data.right.mean(axis=(1, 2))
    ratio, found = float(ratios[few].max()), float(data.right[few].mean())
    beyond = ", ".join(
        f"{share:.0%} moving: {part:.0%}"
        for share, part in zip(data.dynamic[~few], often[~few], strict=True)
    )
    rows = [
        (float(data.dynamic[s]), int(data.n[k]), world,
         int(data.comparisons[s, k, world]), int(data.right[s, k, world]))
        for s, k, world in np.ndindex(data.right.shape)
    ]  # fmt: skip
    header = ("dynamic", "landmarks", "world", "comparisons", "static_bin_right")
    return Outcome(
        Table(header, rows),
        ratio,
        f"Up to {PAPERS_SHARE:.0%} moving, the median world takes at most {ratio:.2f} n log₂ n "
        f"comparisons, and the static bin is right in {found:.0%} of the worlds. Beyond, relmap "
        "never takes n² comparisons: it stops at n log₂ n, and the static bin is right less often "
        f"({beyond}).",
        judged(ratio <= 1.0, found >= OFTEN),
    )


def observed_places(seed: int, largest: int) -> tuple[Floats, Bools]:
    """Return landmarks that a robot sees in each of `BLOCK` iterations, without noise.

    Dynamic ones that never move are excluded: they cannot be detected. Returns `places` (n, i, 3),
    robot frame, metres and `static` (n,).
    """
    world = simulate_figure_eight(6 * largest, BLOCK, sigma=0.0, dynamic=0.4, seed=seed)
    log = world.log
    assert log.ids is not None
    ids, counts = np.unique(log.ids, return_counts=True)
    ids = ids[counts == BLOCK]
    by_landmark = np.lexsort((log.iteration, log.ids))
    rows = by_landmark[np.isin(log.ids[by_landmark], ids)]
    block = log.points_robot[rows].reshape(len(ids), BLOCK, 3)
    R, t = world.trajectory[:, :3, :3], world.trajectory[:, :3, 3]
    place = np.einsum("ijk,nik->nij", R, block) + t
    static = world.status[ids] == "static"
    kept = static | (np.sqrt(place.var(axis=1).sum(axis=1)) > SIGMA_M)
    return block[kept], static[kept]


def block_of(n: int, share: float, pool: Floats, static: Bools, seed: int) -> tuple[Floats, Bools]:
    """Return n of the landmarks, a fraction of them dynamic, with noise; and which are static."""
    rng = np.random.default_rng([seed, n, round(100 * share)])
    n_dynamic = round(share * n)
    chosen = [rng.permutation(np.flatnonzero(~static))[:n_dynamic]]
    chosen.append(rng.permutation(np.flatnonzero(static))[: n - n_dynamic])
    rows = rng.permutation(np.concatenate(chosen))
    return pool[rows] + rng.normal(0, SIGMA_M, (n, BLOCK, 3)), static[rows]


def _plot(data: Comparisons) -> Figure:
    """Draw the comparisons over the number of landmarks, and how often the static bin is right."""
    figure = blank(11.5, 5.2)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_comparisons(left, data)
    _draw_right(right, data)
    return figure


def _draw_comparisons(axes: Axes, data: Comparisons) -> None:
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
    write_in_full(axes.xaxis)
    title = f"Figure 12: comparisons, median of {data.right.shape[2]} worlds\n{_held(data)}"
    finish(axes, title, "landmarks n", "comparisons of two landmarks")
    axes.legend(fontsize=8, loc="lower right")


def _held(data: Comparisons) -> str:
    """Describe how far the number of comparisons stays within n log2 n."""
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
    finish(axes, title, "landmarks n", "share of dynamic landmarks")
    axes.grid(visible=False)
    axes.set_xticks(range(len(data.n)), data.n.tolist())
    axes.set_yticks(range(len(data.dynamic)), [f"{100 * part:.0f} %" for part in data.dynamic])


FIGURE = PaperFigure(
    name="12",
    title="comparisons to find what moves",
    claim=(
        "With up to 40 % of the landmarks moving, binning them takes no more than n log n "
        "comparisons; from about 47 % on it takes n²."
    ),
    criterion=(
        f"up to {PAPERS_SHARE:.0%} moving, the median world takes at most n log₂ n comparisons, "
        f"and in {OFTEN:.0%} of all worlds the static bin is right (at most {MISPLACED:.0%} of the "
        "landmarks misplaced); partly where one of the two holds"
    ),
    unit="most comparisons over n log2 n at up to 40 % moving",
    run=lambda quick, data, watch: sorted_worlds(*(QUICK if quick else FULL), watch),
    judge=_judge,
    draw=_plot,
)
