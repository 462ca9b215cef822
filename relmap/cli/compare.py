"""``relmap compare``: many methods on the same data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli import arguments as args

if TYPE_CHECKING:
    from relmap.evaluation.sources import Source

World = Literal["figure-eight", "building"]

HELP = """Compare methods on the same data: relmap's own, and others.

INPUT is a log of landmarks or of point scans, as for 'relmap map'; or simulate a world.
It prints one table and writes DIR/comparison.csv, comparison.png, and for each method
trajectory-METHOD.tum, map-METHOD.csv and map-METHOD.png.  If the true landmarks are known, the
pictures show the errors as arrows, enlarged by the same factor.  No method uses odometry.

\b
Examples:
  relmap compare --simulate figure-eight -o comparison
  relmap compare --simulate figure-eight --dynamic 0.4 --methods relmap-points,ekf -o moving
  relmap compare --simulate building -o walls
  relmap compare log.observations.csv.gz --truth log_ground_truth.txt --association known -o real

\b
Methods for landmarks:
  relmap-points        refined at the end
  relmap-points-live   the map at the end of the log, without final refinement
  relmap-points-paper  the paper's settings: nearest of the previous iteration, no refinement
  frame-to-frame *     fits every scan to the previous one and chains the steps
  frame-to-map *       fits every scan to the map, then averages it in
  ekf-mrpt *           EKF SLAM without odometry, with a standing prediction, as in MRPT
  ekf *                the same, linearised where the scan fits the map best
  batch *              sparse least squares over all observations: a lower bound of the error
  isam2 *+             gtsam's iSAM2
  gtsam-batch *+       gtsam's batch solver
  kiss-icp +           KISS-ICP: a path, no landmarks
  small-gicp +         small_gicp from scan to scan: a path, no landmarks
Methods for point scans:
  relmap-planes, relmap-planes-live, relmap-planes-paper, kiss-icp +, small-gicp +
Methods for clouds that show floors, ceilings or tilted walls:
  relmap-planes3d, kiss-icp +, small-gicp +

\b
  * needs known ids: --association known
  + needs pip install 'relmap[peers]'

\b
The metrics:
  RMSE        of landmarks (walls: of corners) after rigid alignment [m]
  of          number of landmarks in the RMSE: those that the method mapped
  RMSE10      RMSE of those seen at least ten times
  cover       fraction of the landmarks seen at least ten times that are in the map
  ATE, RPE    absolute and relative error of the path [m]
  path        fraction of iterations with a pose; with several submaps, in the largest only
  pairs, turn mean error against checked relations between poses [m], [rad]
  ms, mean    processor time of an iteration, median and mean [ms]; one thread
  end         median of the last 100 iterations [ms]
  total       time of the whole log, including the final steps [s]
  MB          growth of the process
"""

DENSITY, SIGMA_M, LOOP = 25.0, 0.05, 900
RELATIONS = {"pairs": ("relation_m", ""), "turn": ("relation_rad", "")}
COLUMNS = {
    "RMSE": ("landmark_rmse_m", ""),
    "of": ("matched", "count"),
    "RMSE10": ("often_rmse_m", ""),
    "cover": ("coverage", "share"),
    "ATE": ("ate_m", ""),
    "RPE": ("rpe_m", ""),
    "path": ("path_coverage", "share"),
    **RELATIONS,
    "ms": ("median_ms", "time"),
    "mean": ("mean_ms", "time"),
    "end": ("last_100_median_ms", "time"),
    "total": ("total_s", "time"),
    "MB": ("memory_mb", "count"),
}
"""Name and kind of figure for each column."""
OF_CORNERS = {"RMSE": ("corner_rmse_m", "")}

_Source = Annotated[
    Path | None, typer.Argument(metavar="INPUT", help="The log: a file or a folder.")
]
_Simulate = Annotated[
    World | None, typer.Option(help="Simulate this world instead of reading a log.")
]
_Methods = Annotated[
    str | None,
    typer.Option(metavar="A,B,...", help="Methods to run; by default all that accept the data."),
]
_Association = Annotated[
    args.Association | None,
    typer.Option(help="Whether methods get the ids of the log; by default if the log has ids."),
]
_Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="TRUTH",
        help="The truth, as for 'relmap evaluate'; if not given, the folder truth beside INPUT.",
    ),
]
_Sigma = Annotated[
    float | None,
    typer.Option(
        help="Noise of each coordinate, metres: in the simulation (0.05 by default), and "
        "the noise passed to methods for a log (estimated if not given)."
    ),
]
_Iterations = Annotated[
    int | None, typer.Option(help="Number of scans of a simulated world; one loop if not given.")
]


def command(
    out: args.Out,
    source: _Source = None,
    simulate: _Simulate = None,
    methods: _Methods = None,
    association: _Association = None,
    truth: _Truth = None,
    scans: args.Scans = None,
    log_format: args.Format = None,
    columns: args.Columns = None,
    topic: args.Topics = None,
    sigma: _Sigma = None,
    density: args.Density = DENSITY,
    iterations: _Iterations = None,
    noise: args.Noise = "gaussian",
    dynamic: args.Dynamic = 0.0,
    seed: args.Seed = 0,
) -> None:
    """Compare; the help text explains the arguments."""
    from relmap.cli.compared import compare_into
    from relmap.evaluation.sources import BuildingSource, EightSource, FileSource

    neither = (source is None) == (simulate is None)
    args.refuse(neither, "compare takes either INPUT, a log, or --simulate with a world")
    of_log = any(each is not None for each in (truth, scans, log_format, columns, topic))
    of_world = (density, dynamic, iterations, noise, seed) != (DENSITY, 0.0, None, "gaussian", 0)
    if source is not None:
        message = "--density, --iterations, --noise, --dynamic and --seed are for --simulate"
        args.refuse(of_world, message)
        args.refuse(
            sigma is not None and not 0 < sigma < 1000,
            f"--sigma is {sigma}; it must lie above 0 and below 1000 metres",
        )
        args.refuse(columns and log_format, "--columns applies only to tables of landmarks")
        given: Source = FileSource(source, log_format, scans, truth, columns, tuple(topic or ()))
    else:
        names = "--truth, --scans, --format, --columns and --topic"
        args.refuse(of_log, f"{names} are for INPUT, not for --simulate")
        noise_m = SIGMA_M if sigma is None else sigma
        if simulate == "building":
            of_eight = (density, dynamic) != (DENSITY, 0.0)
            args.refuse(of_eight, "--density and --dynamic are for the figure eight")
            given = BuildingSource(iterations, noise, noise_m, seed)
        else:
            iterations = LOOP if iterations is None else iterations
            given = EightSource(density, iterations, noise, noise_m, dynamic, seed)
        sigma = sigma or SIGMA_M
    chosen = None if methods is None else [name.strip() for name in methods.split(",")]
    rows = compare_into(out, given, chosen, association, sigma)
    ran = sum(row.run is not None for row in rows)
    each = f"{ran} trajector{'ies' if ran > 1 else 'y'} and map{'s' if ran > 1 else ''}"
    typer.echo(f"wrote comparison.csv, {each} and {ran + 1} pictures to {out}")
