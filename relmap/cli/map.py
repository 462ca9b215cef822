"""``relmap map``: make a map from a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from relmap.cli import arguments as args
from relmap.cli import map_options as options
from relmap.cli.interrupt import stoppable

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig

FOR_WALLS = "--level and --segmenter require --variant planes"


def map_command(
    source: args.Log,
    out: args.Out,
    variant: options.Variant = "points",
    association: options.Association = "nearest",
    refine: options.Refine = True,
    scans: args.Scans = None,
    log_format: args.Format = None,
    registration: options.Registration = None,
    config: options.Config = None,
    journal: options.Journal = None,
    onto: options.Onto = None,
    animate: options.Animate = False,
    range_sigma: options.RangeSigma = None,
    bearing_sigma: options.BearingSigma = None,
    elevation_sigma: options.ElevationSigma = None,
    odometry: options.Odometry = "auto",
    columns: args.Columns = None,
    topic: args.Topics = None,
    voxel: options.Voxel = None,
    live: options.Live = False,
    live_file: options.LiveFile = None,
    level: options.Level = None,
    segmenter: options.Segmenter = None,
) -> None:
    """Map a log; the help text explains the arguments."""
    planes, known = variant == "planes", association == "known"
    sigmas = _sigmas(planes, range_sigma, bearing_sigma, elevation_sigma)
    args.refuse((level or segmenter) and not planes, FOR_WALLS)
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
