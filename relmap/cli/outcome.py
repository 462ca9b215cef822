"""Run a job, and report its outcome, complete or not."""

from __future__ import annotations

from time import monotonic
from typing import Any

import numpy as np
import typer

from relmap.cli.console import INTERRUPTED, counted, lasting
from relmap.cli.job import Job
from relmap.cli.mapping import map_log
from relmap.cli.warned import warned
from relmap.core.arrays import Floats
from relmap.core.refinement.hinges import DOMINANT
from relmap.io.results import Result

OFTEN = 10
"""Observations that make a landmark worth mapping."""
FEWEST = 4
"""Scans that must show a wall of the map; smaller submaps are never refined."""
WHOLE = 0.9
"""Minimum fraction of the scans in the largest submap of an unbroken run."""
STILL_SCANS, STILL_M, STILL_RAD = 10, 0.1, 0.05
"""Fewest scans that show that a robot stood still, and the largest error of its poses then."""
FEW = 5
"""Most iterations that a message lists."""
NOTHING = (
    "; nothing is mapped: a map needs landmarks that are seen together in at least four scans, "
    "three in the plane and four in space"
)
NO_WALL = ": a map needs walls that are seen in at least four scans"
UNCONNECTED = (
    "; no two scans could be connected: they must show planes of three directions, and overlap, so "
    "shorter steps and turns may help"
)
SINGLE = "; nothing is mapped: a map needs planes that at least two scans show"


def report(job: Job) -> None:
    """Map a log, and report the result; typer.Exit if the run was interrupted."""
    began = monotonic()
    run, n_files = map_log(job)
    took = f", {lasting(monotonic() - began)} in all"
    summary = run.result.summary
    counts, timing = summary["counts"], summary["timing"]
    iterations = counted(counts["iterations"], "iteration")
    begun = f"stopped after {counts['iterations']} of {summary['input_iterations']}: "
    message = begun if summary["interrupted"] else ""
    message += f"wrote {n_files} files to {job.at(job.out)}: "
    hanging, warning = on_odometry(summary.get("odometry")), ""
    if job.variant == "planes3d":
        planes = f"{counts['planes_static']} planes mapped in {iterations}"
        message += f"{planes}, {each(timing['scan_median_ms'])}{took}{in_space(summary)}"
    elif job.variant == "planes":
        message += (
            f"{counts['planes_static']} walls with {counts['corners_static']} corners mapped in "
            f"{iterations}, {each(timing['scan_median_ms'])}{took}{hanging}"
            f"{torn(summary, job.refine)}"
        )
    else:
        message += (
            f"{counts['mapped']} of {counts['landmarks']} landmarks{often(run.result)} mapped from "
            f"{counts['observations']} observations in {iterations}, "
            f"{each(timing['median_ms'])}{took}{untied(counts, len(run.result.submaps) - 1)}"
            f"{'' if counts['mapped'] else NOTHING}{doubted(summary)}{nameless(summary)}"
            f"{overruled(summary)}{hanging}"
        )
        warning = warned(summary)
    typer.echo(f"{message}{still(run.result.poses)}{warning}")
    if job.onto and job.association == "nearest" and summary["tied_at"] is None:
        typer.echo(
            f"the log could not be localised in the map of {job.onto}: it forms a separate submap"
        )
    if summary["interrupted"]:
        if job.journal is not None:
            typer.echo(f"'relmap resume {job.journal}' continues it")
        raise typer.Exit(INTERRUPTED)


def still(poses: Floats) -> str:
    """Return that the robot stood still, as the end of a message: a log may be in a fixed frame."""
    off_m = np.linalg.norm(poses[:, :3, 3] - poses[:1, :3, 3], axis=1)
    turned = np.linalg.norm(poses[:, :3, :3] - poses[:1, :3, :3], axis=(1, 2)) / np.sqrt(2)
    if len(poses) < STILL_SCANS or off_m.max() > STILL_M or turned.max() > STILL_RAD:
        return ""
    return (
        f"; in the map the robot moves less than {STILL_M} m: if it did move, the observations are "
        "not in its frame"
    )


def often(result: Result) -> str:
    """Return how many of the landmarks seen often are mapped, if not all landmarks are."""
    seen = result.landmarks.observations >= OFTEN
    if result.mapped.all() or not seen.any():
        return ""
    return f" ({(seen & result.mapped).sum()} of {seen.sum()} seen {OFTEN} times or more)"


def each(median_ms: float | None) -> str:
    """Return the time of an iteration, as part of a message."""
    if median_ms is None:
        return "none of them new"
    value, unit = (median_ms / 1e3, "s") if median_ms >= 1e3 else (median_ms, "ms")
    digits = 2 if value < 1 else 1 if value < 10 else 0
    return f"median {value:.{digits}f} {unit} each"


def torn(summary: dict[str, Any], refine: bool) -> str:
    """Return the submaps of walls, refined if asked, and weak links: the end of a message."""
    usable = [submap for submap in summary["submaps"] if submap["scans"] >= FEWEST]
    failed = sum(not submap["refined"] for submap in usable) if refine else 0
    message = ""
    if not summary["counts"]["planes_static"]:
        message = "; nothing is mapped" + ("" if failed else NO_WALL)
    message += broken(summary) + blind(summary)
    if failed:
        which = "only" if len(summary["submaps"]) == 1 else "largest"
        several = f"{failed} of {len(usable)} submaps of four scans or more"
        message += f"; {several if len(usable) > 1 else f'the {which} submap'} could not be refined"
    odometry = summary.get("odometry")
    bridged = odometry["tied_by_it_alone"]["stretches"] if odometry else []
    weak = [k for k in summary["weak_links"] if not any(a <= k <= b for a, b in bridged)]
    if weak:
        message += f"; steps that the scans do not determine, and that may be wrong: {len(weak)}"
    return message + advice(summary)


def in_space(summary: dict[str, Any]) -> str:
    """Return the submaps and uncertain scans of a run in space: the end of a message."""
    if not summary["submaps"]:
        return "; no plane was found: the clouds show none, or are not in metres"
    if summary["submaps"][0]["scans"] == 1:
        return UNCONNECTED if len(summary["submaps"]) > 1 else SINGLE
    weak = len(summary["weak_links"])
    unsure = f"; scans whose position is poorly determined in some direction: {weak}"
    return broken(summary) + blind(summary) + (unsure if weak else "") + advice(summary)


def broken(summary: dict[str, Any]) -> str:
    """Return that a run broke into submaps, as part of a message; nothing if it did not."""
    submaps = summary["submaps"]
    if len(submaps) < 2:
        return ""
    scans, metres = submaps[0]["scans"], submaps[0]["metres"]
    of = f"{counted(scans)} and {metres:.1f} m"
    if summary.get("onto"):
        return f"; there are {len(submaps)} submaps: that of the earlier map, of {of}, is the map"
    alone = _left_out(submaps)
    if len(alone) == len(submaps) - 1:
        n_scans = sum(submap["scans"] for submap in alone)
        spans = (dict.fromkeys(map(str, submap["iterations"])) for submap in alone[:FEW])
        at = ", ".join("-".join(span) for span in spans)
        at += ", ..." if len(alone) > FEW else ""
        return f"; scans that fit nowhere, and are not in the map: {n_scans} (iterations {at})"
    parts = f"; the run broke into {len(submaps)} submaps"
    if not summary["counts"]["planes_static"]:
        return f"{parts}, the largest of {of}"
    return f"{parts}: the largest, of {of}, is the map"


def blind(summary: dict[str, Any]) -> str:
    """Return how many scans are in no submap, as part of a message: they show no walls."""
    placed = sum(submap["scans"] for submap in summary["submaps"])
    n_blind = 0 if summary.get("onto") else summary["counts"]["iterations"] - placed
    which = "planes" if summary["variant"] == "planes3d" else "walls"
    return f"; scans that show hardly any {which}, and have no pose: {n_blind}" * (n_blind > 0)


def _left_out(submaps: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the submaps of a few scans in the midst of the largest: not breaks of the run."""
    begin, end = submaps[0]["iterations"]
    return [
        submap
        for submap in submaps[1:]
        if submap["scans"] < FEWEST
        and begin < submap["iterations"][0]
        and submap["iterations"][1] < end
    ]


def advice(summary: dict[str, Any]) -> str:
    """Return advice for a run that broke into submaps, as the end of a message."""
    apart = summary.get("onto") and summary["tied_at"] is None
    scans = [submap["scans"] for submap in summary["submaps"]]
    if apart or not scans or scans[0] >= WHOLE * sum(scans):
        return ""
    median_m, median_deg, view_deg = (
        summary["steps"][name] for name in ("median_m", "median_deg", "view_deg")
    )
    step, view = "", "" if view_deg is None else f" (here {view_deg:.0f} degrees)"
    if median_m is not None:
        step = f" (here {median_m:.2f} m and {median_deg:.0f} degrees in the median)"
    return (f". More overlap between scans helps: shorter steps{step} or a wider view{view}") + (
        "; odometry, if available, bridges breaks" if summary["variant"] == "planes" else ""
    )


def doubted(summary: dict[str, Any]) -> str:
    """Return the reliability of the association, as the end of a message."""
    trust = summary["association_trust"]
    tied, unique, undone = (trust[key] for key in ("tied_scans", "unique_scans", "undone_merges"))
    message = ""
    if tied is not None and min(tied, unique) < 1:
        message += (
            f"; {100 * tied:.1f} % of the scans were matched to earlier ones, {100 * unique:.1f} % "
            f"with more matches than expected by chance"
        )
    message += f"; {counted(undone, 'merge')} undone" if undone else ""
    if trust["gaps"]:
        message += (
            f"; only places that look the same bridge {counted(trust['gaps'], 'gap')} of up to "
            f"{trust['longest_gap']} scans"
        )
    return message + hanging_together(trust)


def hanging_together(trust: dict[str, Any]) -> str:
    """Return how far off the map may be where too few landmarks hold it together, or nothing."""
    hinges = trust["hinges"]
    if hinges is None or hinges["share"] < DOMINANT:
        return ""
    at = ", ".join(str(after) for _, after in hinges["steps"][:FEW])
    at += ", ..." if len(hinges["steps"]) > FEW else ""
    return (
        f"; expected error of the map: {trust['expected_error_m']:.2g} m, mostly because too few "
        f"landmarks are tracked into iteration{'s' * (len(hinges['steps']) != 1)} {at}"
    )


def nameless(summary: dict[str, Any]) -> str:
    """Return how many observations have no id where ids are used, as part of a message."""
    count = summary["counts"]["observations_without_id"]
    if summary["association"] != "known" or not count:
        return ""
    return f"; left out, as they have no id: {counted(count, 'observation')}"


def overruled(summary: dict[str, Any]) -> str:
    """Return how many given ids were overruled, as the end of a message."""
    if summary["association"] != "known":
        return ""
    rows, scans = (summary[f"rejected_{name}"]["count"] for name in ("observations", "iterations"))
    of = [f"of {counted(rows, 'observation')}"] * (rows > 0)
    of += [f"of all in {counted(scans)}"] * (scans > 0)
    return f"; overruled ids: {', '.join(of)}" if of else ""


def on_odometry(odometry: dict[str, Any] | None) -> str:
    """Return what depends on odometry alone, or that it is wrong, as the end of a message."""
    if odometry is None:
        return ""
    if odometry["wrong_throughout"]:
        return (
            "; odometry contradicts the observations and was not used (it must be in metres and "
            "radians, turns to the left positive; odometry.csv holds motions, not poses)"
        )
    alone, left_out = (odometry[key]["count"] for key in ("tied_by_it_alone", "left_out"))
    linked = "is" if alone == 1 else "are"
    message = f"; {counted(alone)} {linked} linked by odometry alone" if alone else ""
    message += f"; odometry was rejected at {counted(left_out)}" if left_out else ""
    if odometry["alike_elsewhere"]:
        message += (
            f"; {odometry['alike_elsewhere']} landmarks look like others elsewhere, but odometry "
            "tells them apart"
        )
    if odometry["of_two_places"]["count"]:
        listed = ", ".join(map(str, odometry["of_two_places"]["ids"][:FEW]))
        message += f"; not mapped, as observations of their id show two places: {listed}"
        message += ", ..." if odometry["of_two_places"]["count"] > FEW else ""
    worst_m = odometry["largest_sd_m"]
    if alone and worst_m is not None:
        message += f"; the least certain landmark has a standard deviation of {worst_m:.2g} m"
    if alone and odometry["noise_assumed"]:
        message += " (of odometry's usual noise: scans show too little to measure it)"
    return message


def untied(counts: dict[str, int], submaps: int) -> str:
    """Return the number of separate submaps of a map of points, as the end of a message."""
    if submaps < 1:
        return ""
    placed = counts["iterations"] - counts["iterations_without_pose"]
    apart = f"; {counted(submaps, 'submap')} could not be connected to the map"
    return f"{apart}, in which {placed} of {counted(counts['iterations'])} have a pose"
