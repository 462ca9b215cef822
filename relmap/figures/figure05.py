"""Figure 5: the test bench, from points to planes to a map."""

from __future__ import annotations

from pathlib import Path

from relmap.evaluation.evaluate import Evaluation, evaluate
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import BuildingSource
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.planes import PlaneMapper
from relmap.plots.bench import plot_bench, write_bench_gif
from relmap.plots.bench_recorder import COLUMNS, FRAMES, BenchFrame, BenchRecorder, frame_step
from relmap.segmentation import PlaneSegmenter

SIGMA_M = 0.05
QUICK_ITERATIONS = 40
QUICK_FRAMES = 10
COVERED = 0.8
TITLE = "Figure 5: the test bench"


Bench = tuple[list[BenchFrame], int, Evaluation]
"""Pictures of a run, the last one at the end, the number of scans, and figures of merit."""


def _run(quick: bool, data: Path | None, watch: Watch) -> Bench:
    """Map a building and record the bench at intervals."""
    seen = BuildingSource(QUICK_ITERATIONS if quick else None, sigma=SIGMA_M).load()
    log, truth = seen.log, seen.truth
    assert truth is not None
    mapper, segmenter = PlaneMapper(), PlaneSegmenter()
    every = frame_step(len(log), QUICK_FRAMES if quick else FRAMES)
    recorder = BenchRecorder(log, segmenter, truth, every)
    run = run_mapper(
        mapper,
        log,
        through=lambda scans: recorder.watch(mapper, watch(list(scans))),
        refine=True,
        segmenter=segmenter,
    )
    frames = [*recorder.frames, recorder.frame(mapper)]
    return frames, len(log), evaluate(run.result, truth)


def _judge(bench: Bench) -> Outcome:
    frames, n_scans, found = bench
    rmse_m, coverage = found.corner_rmse_m, found.coverage or 0.0
    corners = "no corner" if rmse_m is None else f"corners to {rmse_m:.3f} m"
    return Outcome(
        Table(COLUMNS, list(frames[-1].rows())),
        float("nan") if rmse_m is None else rmse_m,
        f"{len(frames[-1].walls)} walls after {n_scans} scans, {corners} (RMSE; noise of points "
        f"{SIGMA_M} m), {coverage:.0%} of the corners seen ten times mapped.",
        judged(rmse_m is not None and rmse_m < SIGMA_M, coverage >= COVERED),
        {".gif": lambda path: write_bench_gif(path, frames, title=TITLE)},
    )


FIGURE = PaperFigure(
    name="5",
    title="the test bench of the planes",
    claim=(
        "Points of a simulated building, turned into planes by an EM algorithm, are mapped to the "
        "walls that are there, and groups tie them together."
    ),
    criterion=(
        f"corners are better than a single point (RMSE below sigma, {SIGMA_M} m), and "
        f"{COVERED:.0%} of those seen ten times are mapped; partly where one of the two holds"
    ),
    unit="RMSE of the corners in m",
    run=_run,
    judge=_judge,
    draw=lambda bench: plot_bench(bench[0][-1], TITLE),
)
