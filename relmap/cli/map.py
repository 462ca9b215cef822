"""``relmap map``: make a map from a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli import arguments as args
from relmap.cli.interrupt import stoppable

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig

HELP = """Make a map from a log of landmarks or of scans.

INPUT is a file or folder. The simplest is a CSV file with the header iteration,x,y,z or
iteration,x,y (a planar world) and one row per observation of a landmark: its position in the robot
frame (x ahead, y left, z up, metres). Instead of x,y,z there may be range,bearing,elevation
(metres, radians). An optional column id identifies the landmark. If the log has odometry, it is
used; any log may also have a file odometry.csv beside it, with the header iteration,x,y,yaw or
iteration,x,y,z,qx,qy,qz,qw: the motion of the robot from the previous iteration to this one.

\b
Formats of INPUT:
  observation-csv  the CSV file just described, or a folder with observations.csv
  mrpt-landmarks   range and bearing to landmarks, from a log of MRPT
  victoria-park    trees per scan, from the Victoria Park data set
  dlr-circles      circles on a floor, map.circles of the DLR spatial cognition data set
  slsjf-sim        range and bearing to beacons, the folder of I-SLSJF's simulation
  mrclam           range and bearing to bar codes, the folder of MRCLAM (all robots, one after
                   another) or RobotN_Measurement.dat in it (one robot)
  own-table        a CSV file with other names for its columns, see --columns, or a Parquet file
  bag-detections   a bag of ROS 1 or 2, or an MCAP file, with Detection3DArray, MarkerArray,
                   AprilTagDetectionArray or PoseArray (pip install 'relmap[bags]')

\b
With --variant planes INPUT is a log of point scans, and walls are mapped:
  scans-npz        scans.npz with points (n, 2) or (n, 3) in the frame of the sensor, iteration
                   (n,) and stamps_s, as 'relmap simulate building' writes it, or its folder
  carmen-log       2-D laser scans of CARMEN, .log or .log.gz
  mrpt-laser2d     2-D laser scans of MRPT's simulation, *.scans.csv.gz
  point-clouds     a folder of .pcd or .ply files, one per scan
  bag-scans        a bag of ROS 1 or 2, or an MCAP file, with LaserScan or PointCloud2
                   (pip install 'relmap[bags]')
  kitti-bin        a folder of .bin files, float32 x, y, z and reflectance, one for each scan
  depth-images     a folder of 16-bit depth images *.depth.png, with camera-intrinsics.txt
  tum-rgbd         a folder of TUM RGB-D: depth.txt or associations.txt, and depth/*.png

With --variant planes3d the same formats are read, but planes of any direction are mapped, and the
sensor may move in all directions and tilt: clouds of a lidar or a depth camera. Of the options
below it takes --voxel, --scans, --format, --topic, --journal, --no-refine, --odometry none, --live
and --live-file.

It writes DIR/landmarks.csv, tracks.csv.gz, trajectory.tum, map.ply, map.png, report.html (an
interactive page with the map and a replay of the run), submaps.csv, summary.json and mapper.npz,
the saved state, of walls and planes also planes.csv, and of walls bench.png: the last scan, its
planes, the map and its groups; with --animate the whole run as bench.gif. The path in each separate
submap of at least ten scans is in submap-K.tum, its walls in submap-K.csv. Ctrl-C ends the mapping
early and writes the map so far; pressed again it exits at once.

\b
Examples:
  relmap map eight/observations.csv -o result
  relmap map eight/observations.csv -o result --association known --scans 0:300
  relmap map building/scans.npz -o result --variant planes
  relmap map seen.csv -o result --columns x=px,y=py,iteration=frame,stamp=t,id=name
  relmap map hall -o result --variant planes3d
"""

WIDEST_RAD = 0.5
"""Larger standard deviations of an angle are hardly in radians."""


def command(
    source: args.Log,
    out: args.Out,
    variant: Annotated[
        args.Variant,
        typer.Option(
            help="Kind of landmarks: points; walls in point scans; or planes of any direction in "
            "clouds of a carried lidar or depth camera."
        ),
    ] = "points",
    association: Annotated[
        args.Association,
        typer.Option(help="Match observations to landmarks, or use the ids of the log."),
    ] = "nearest",
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine",
            help="Refine the map at the end by joint least squares over all observations.",
        ),
    ] = True,
    scans: args.Scans = None,
    log_format: args.Format = None,
    registration: Annotated[
        Literal["constellation", "nearest-previous"] | None,
        typer.Option(
            help="How observations without ids are matched: by consistent constellations, or "
            "as in the paper, to the nearest of the previous iteration.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="Settings of the mapper: the fields of relmap.MapperConfig, as field = value.",
        ),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Record the run in this SQLite file, so that 'relmap resume FILE' "
            "can continue it if it ends early.",
        ),
    ] = None,
    onto: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT",
            help="Add the log to the map in this result folder: once a scan is localised in it, "
            "mapping continues from there. Walls are added where refinement joins their submaps.",
        ),
    ] = None,
    animate: Annotated[
        bool,
        typer.Option("--animate", help="For walls: draw the whole run as an animation, bench.gif."),
    ] = False,
    range_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Standard deviation of the measured ranges; with --bearing-sigma each "
            "observation is weighted by its own noise. By default as given by the log.",
        ),
    ] = None,
    bearing_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="RADIANS",
            help="Standard deviation of the measured bearings, radians; requires --range-sigma.",
        ),
    ] = None,
    elevation_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="RADIANS",
            help="In space: the same for elevations; by default --bearing-sigma.",
        ),
    ] = None,
    odometry: Annotated[
        args.Odometry,
        typer.Option(
            help="Use the odometry of the log, or of a file beside it, odometry.csv or "
            "odometry.tum; or none, as in the paper."
        ),
    ] = "auto",
    columns: args.Columns = None,
    topic: args.Topics = None,
    voxel: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="For planes3d: initial voxel size; chosen from the clouds if not given.",
        ),
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Show map, path and scan during the run (pip install 'relmap[live]')."
        ),
    ] = False,
    live_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd",
            help="Record the live view in a file for the Rerun viewer instead; needs no display.",
        ),
    ] = None,
    level: Annotated[
        args.Level | None,
        typer.Option(
            help="For walls: level clouds that show floors, ceilings or tilted walls by their "
            "planes, and reduce them to 2-D scans of the walls (auto, the default); or refuse them "
            "(none)."
        ),
    ] = None,
    segmenter: Annotated[
        Literal["em", "ransac", "mixture", "ransac3d", "patches", "scanlines"] | None,
        typer.Option(
            help="For walls: how points become walls. Default: scanlines for 2-D scans, em for "
            "clouds."
        ),
    ] = None,
) -> None:
    """Map a log; the help text explains the arguments."""
    planes, known = variant == "planes", association == "known"
    sigmas = _sigmas(planes, range_sigma, bearing_sigma, elevation_sigma)
    message = "--level and --segmenter require --variant planes"
    args.refuse((level or segmenter) and not planes, message)
    others = (known, registration, config, onto, animate, columns, sigmas)
    _check_space(variant, voxel, any(others))
    args.refuse(columns and (planes or log_format), "--columns applies only to tables of landmarks")
    message = "--journal records a run from its beginning, so it cannot be used with --onto"
    args.refuse(onto and journal, message)
    message = "--onto uses the settings of the earlier run: give no others"
    args.refuse(onto and (config or registration), message)
    args.refuse(animate and not planes, "--animate draws walls: give --variant planes with it")
    from relmap.cli.job import Job
    from relmap.cli.outcome import report

    with stoppable() as stopped:
        job = Job(
            source=source,
            out=out,
            variant=variant,
            settings=_settings(config, registration, planes, known),
            association=association,
            interval=scans,
            log_format=log_format,
            refine=refine,
            journal=journal,
            onto=onto,
            animate=animate,
            sigmas=sigmas,
            odometry=odometry,
            level=level or ("auto" if planes else "none"),
            segmenter=segmenter,
            voxel_m=voxel,
            columns=columns,
            topics=tuple(topic or ()),
            live=live or live_file is not None,
            live_file=live_file,
            stopped=stopped,
        )
        report(job)


def _check_space(variant: str, voxel: float | None, others: bool) -> None:
    """Check the options of planes in space; `others`: whether any that they ignore is given."""
    in_space = variant == "planes3d"
    args.refuse(voxel is not None and not in_space, "--voxel requires --variant planes3d")
    message = (
        "--variant planes3d accepts only --scans, --format, --topic, --journal, --no-refine, "
        "--odometry none, --live, --live-file and --voxel"
    )
    args.refuse(in_space and others, message)
    low = voxel is not None and not 0 < voxel < float("inf")
    args.refuse(low, f"--voxel is {voxel}; it must be above 0")


def _sigmas(
    planes: bool, range_m: float | None, bearing_rad: float | None, elevation_rad: float | None
) -> tuple[float, ...] | None:
    """Return the noise of range, bearing and, if given, elevation."""
    names = ("--range-sigma", "--bearing-sigma", "--elevation-sigma")
    sigmas = dict(zip(names, (range_m, bearing_rad, elevation_rad), strict=True))
    given = {name: sigma for name, sigma in sigmas.items() if sigma is not None}
    args.refuse(given and planes, "the noise of walls is estimated: omit --range-sigma")
    one = given and (range_m is None or bearing_rad is None)
    args.refuse(one, "--range-sigma and --bearing-sigma must be given together")
    for name, sigma in given.items():
        args.refuse(not 0 < sigma < float("inf"), f"{name} is {sigma}; it must be above 0")
        wide = name != names[0] and sigma >= WIDEST_RAD
        args.refuse(wide, f"{name} is {sigma}; it must be below {WIDEST_RAD} radians")
    return tuple(given.values()) or None


def _settings(
    config: Path | None, registration: str | None, planes: bool, known: bool
) -> MapperConfig:
    from relmap.core.config import WITH_IDS, WITH_POINTS, WITH_WALLS

    message = "walls have no ids: --association and --registration apply only to points"
    args.refuse(planes and (known or registration), message)
    message = "--registration applies to observations without ids: omit --association"
    args.refuse(known and registration, message)
    unused = WITH_WALLS if planes else WITH_IDS if known else WITH_POINTS
    return args.read_config(config, registration, unused)
