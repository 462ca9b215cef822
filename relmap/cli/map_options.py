"""The help text and the options of ``relmap map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from relmap.cli import arguments as args

HELP = """Make a map from a log of landmarks or of scans.

INPUT is a file or folder. The simplest is a CSV file with the header iteration,x,y,z or
iteration,x,y (a planar world) and one row per observation of a landmark: its position in the robot
frame (x ahead, y left, z up, metres). An optional column id identifies the landmark. If the log has
odometry, it is used; any log may also have a file odometry.csv beside it, with the header
iteration,x,y,yaw or iteration,x,y,z,qx,qy,qz,qw: the motion of the robot from the previous
iteration to this one.

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
  kitti-bin        a folder of .bin files, float32 x, y, z and intensity, one for each scan
  depth-images     a folder of 16-bit depth images *.depth.png, with camera-intrinsics.txt

With --variant planes3d the same formats are read, but planes of any direction are mapped, and the
sensor may move in all directions and tilt: clouds of a lidar or a depth camera. Of the options
below it takes --voxel, --scans, --format, --topic, --journal, --no-refine, --live and --live-file.

It writes DIR/landmarks.csv, tracks.csv.gz, trajectory.tum, map.ply, map.png, report.html (an
interactive page with the map and a replay of the run), submaps.csv, summary.json and mapper.npz,
the saved state, of walls and planes also planes.csv, and of walls bench.png: the last scan, its
planes, the map and its groups; with --animate the whole run as bench.gif. Ctrl-C ends the mapping
early and writes the map so far; pressed again it exits at once.

\b
Examples:
  relmap map eight/observations.csv -o result
  relmap map eight/observations.csv -o result --association known --scans 0:300
  relmap map building/scans.npz -o result --variant planes
  relmap map seen.csv -o result --columns x=px,y=py,iteration=frame,stamp=t,id=name
  relmap map hall -o result --variant planes3d
"""

Variant = Annotated[
    args.Variant,
    typer.Option(
        help="Kind of landmarks: points; walls in point scans; or planes of any direction in "
        "clouds of a carried lidar or depth camera."
    ),
]
Voxel = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="For planes3d: initial voxel size; chosen from the clouds if not given.",
    ),
]
Association = Annotated[
    args.Association,
    typer.Option(help="Match observations to landmarks, or use the ids of the log."),
]
Refine = Annotated[
    bool,
    typer.Option(
        "--refine/--no-refine",
        help="Refine the map at the end by joint least squares over all observations.",
    ),
]
Registration = Annotated[
    Literal["constellation", "nearest-previous"] | None,
    typer.Option(
        help="How observations without ids are matched: by consistent constellations, or "
        "as in the paper, to the nearest of the previous iteration.",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.toml",
        help="Settings of the mapper: the fields of relmap.MapperConfig, as field = value.",
    ),
]
Journal = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Record the run in this SQLite file, so that 'relmap resume FILE' "
        "can continue it if it ends early.",
    ),
]
RangeSigma = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Standard deviation of the measured ranges; with --bearing-sigma each "
        "observation is weighted by its own noise. By default as given by the log.",
    ),
]
BearingSigma = Annotated[
    float | None,
    typer.Option(
        metavar="RADIANS",
        help="Standard deviation of the measured bearings, radians; requires --range-sigma.",
    ),
]
ElevationSigma = Annotated[
    float | None,
    typer.Option(
        metavar="RADIANS",
        help="In space: the same for elevations; by default --bearing-sigma.",
    ),
]
Odometry = Annotated[
    args.Odometry,
    typer.Option(
        help="Use the odometry of the log, or of a file beside it, odometry.csv or "
        "odometry.tum; or none, as in the paper."
    ),
]
Level = Annotated[
    args.Level | None,
    typer.Option(
        help="For walls: level clouds that show floors, ceilings or tilted walls by their planes, "
        "and reduce them to 2-D scans of the walls (auto, the default); or refuse them (none)."
    ),
]
Segmenter = Annotated[
    Literal["em", "ransac", "mixture", "ransac3d", "patches", "scanlines"] | None,
    typer.Option(
        help="For walls: how points become walls. Default: scanlines for 2-D scans, em for clouds."
    ),
]
Onto = Annotated[
    Path | None,
    typer.Option(
        metavar="RESULT",
        help="Add the log to the map in this result folder: once a scan is localised in it, "
        "mapping continues from there. Walls are added if a stretch of 7 m fits in one place only.",
    ),
]
Animate = Annotated[
    bool,
    typer.Option("--animate", help="For walls: draw the whole run as an animation, bench.gif."),
]

Live = Annotated[
    bool,
    typer.Option(
        "--live", help="Show map, path and scan during the run (pip install 'relmap[live]')."
    ),
]
LiveFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.rrd",
        help="Record the live view in a file for the Rerun viewer instead; needs no display.",
    ),
]
