"""Figure 5: the test bench, from points to planes to a map."""

from __future__ import annotations

from pathlib import Path

from relmap.evaluation.evaluate import evaluate
from relmap.evaluation.run import run_mapper
from relmap.evaluation.sources import BuildingSource
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.planes import PlaneMapper
from relmap.plots.bench import plot_bench, write_bench_gif
from relmap.plots.bench_recorder import BenchRecorder, frame_step
from relmap.segmentation import PlaneSegmenter

SIGMA_M = 0.05
QUICK_ITERATIONS = 40
FRAMES, QUICK_FRAMES = 80, 10
COVERED = 0.8
TITLE = "Figure 5: the test bench"


def _run(quick: bool, data: Path | None, watch: Watch) -> Outcome:
    """Map a building and keep a picture of the bench now and then."""
    source = BuildingSource(QUICK_ITERATIONS if quick else None, sigma=SIGMA_M)
    seen = source.load()
    log, truth = seen.log, seen.truth
    assert truth is not None
    mapper, segmenter = PlaneMapper(), PlaneSegmenter()
    every = frame_step(len(log), QUICK_FRAMES if quick else FRAMES)
    recorder = BenchRecorder(mapper, segmenter, truth, every)
    run = run_mapper(
        mapper,
        log,
        progress=lambda scans: recorder.watch(watch(list(scans))),
        refine=True,
        segmenter=segmenter,
    )
    last = recorder.last()
    assert last is not None
    found = evaluate(run.result, truth)
    rmse_m, coverage = found.corner_rmse_m, found.coverage or 0.0
    told = "no corner" if rmse_m is None else f"corners to {rmse_m:.3f} m"
    return Outcome(
        lambda: plot_bench(last, TITLE),
        Table(last.COLUMNS, list(last.rows())),
        float("nan") if rmse_m is None else rmse_m,
        "RMSE of the corners in m",
        f"{len(last.walls)} walls after {len(log)} scans, {told} (RMSE, points have a noise of "
        f"{SIGMA_M} m), {coverage:.0%} of the corners seen ten times mapped.",
        judged(rmse_m is not None and rmse_m < SIGMA_M, coverage >= COVERED),
        {".gif": lambda path: write_bench_gif(path, [*recorder.frames, last], title=TITLE)},
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
    run=_run,
)
