"""Warnings that a map of points may be wrong, as lines after the closing line."""

from __future__ import annotations

from typing import Any

from relmap.cli.console import counted

CONTRADICTED = 0.1
"""Noise, as a fraction of the distance of the landmarks, that no sensor of landmarks has."""
MISREAD = 0.04
"""Fraction of the observations contradicting their ids above which a map may be wrong: of 49
simulated ones one of 12 with 2 % wrong ids was, 3 of 13 with 5 %, 5 of 14 with 10 %, 8 of 10 with
20 %."""
OUTLYING = 0.02
"""The same without ids: of right maps at most 0.016, with the noise of a stereo camera."""
FLEETING = 1 / 3
"""Fraction of the observations whose landmark is seen once or twice, above which scans do not show
one place: at most 0.24 with 30 % of false detections, 0.45 where two robots share them."""
MOST_LISTED = 5
"""Most iterations that a warning lists."""


def warned(summary: dict[str, Any]) -> str:
    """Return all warnings of a summary."""
    trust, has_ids = summary["association_trust"], summary["association"] == "known"
    uses_odometry = bool(summary.get("odometry") and summary["odometry"]["used"])
    of_all = doubtful(summary["refinement"], trust["contradicting"], has_ids, uses_odometry)
    of_all += "" if has_ids else fleeting(trust["seen_twice_at_most"])
    of_parts = leapt(trust["leaps"]) + crept(trust["creep_m"]) + missed(summary["submaps"])
    return of_all + of_parts + rescaled(trust["added_lengths"], "this log measures")


def fleeting(share: float | None) -> str:
    """Return a warning that a share of the observations is not seen again, as a line."""
    if not share or share <= FLEETING:
        return ""
    return (
        f"\nWARNING: {100 * share:.0f} % of the observations are of landmarks seen once or twice: "
        "the map may be wrong, as where scans mix the observations of two robots"
    )


def leapt(leaps: dict[str, Any] | None) -> str:
    """Return a warning that the robot leaps in the map, as a line."""
    if not leaps or not leaps["count"]:
        return ""
    (before, after), others = leaps["steps"][0], leaps["count"] - 1
    more = f", and {counted(others, 'time')} more" if others else ""
    return (
        f"\nWARNING: in the map the robot leaps {leaps['way_m'][0]:.1f} m from iteration {before} "
        f"to {after}{more}: unless it was carried there, places that look the same were taken for "
        "one"
    )


def crept(creep_m: float | None) -> str:
    """Return a warning that landmarks creep in the map, metres per iteration."""
    if not creep_m:
        return ""
    return (
        f"\nWARNING: in the map landmarks move by about {creep_m:.1g} m per iteration along one "
        "direction: it may be wrong, as many may move slowly together, or the observations have "
        "systematic errors"
    )


def rescaled(lengths: float | None, which: str) -> str:
    """Return a warning that what is added has `lengths` times those of the earlier map."""
    if not lengths:
        return ""
    percent, other = 100 * abs(lengths - 1), "longer" if lengths > 1 else "shorter"
    return (
        f"\nWARNING: {which} distances at least {percent:.1f} % {other} than the earlier one: "
        "unless one of them is scaled, landmarks are mapped twice, or in between"
    )


def missed(submaps: list[dict[str, Any]]) -> str:
    """Return a warning that scans contradict submaps of points."""
    found = [(k, one["contradicted_at"]) for k, one in enumerate(submaps)]
    at = [f"{iteration} (submap {k})" for k, iteration in found if iteration is not None]
    if not at:
        return ""
    more = ", ..." if len(at) > MOST_LISTED else ""
    return (
        f"\nWARNING: landmarks that should be in view are not seen in iteration"
        f"{'s' * (len(at) > 1)} {', '.join(at[:MOST_LISTED])}{more}: places that look the same "
        "may have been taken for one, or many landmarks were removed"
    )


def doubtful(
    refinement: dict[str, Any] | None,
    contradicting: float | None,
    has_ids: bool = True,
    uses_odometry: bool = False,
) -> str:
    """Return a warning that the map may be wrong, as a line.

    `contradicting`: fraction of the observations that contradict their ids or the map;
    `uses_odometry`: whether the map depends on odometry.
    """
    if refinement and refinement["noise_m"] > CONTRADICTED * refinement["median_range_m"]:
        noise_m, range_m = refinement["noise_m"], refinement["median_range_m"]
        return (
            f"\nWARNING: the observations contradict the map by {noise_m:.2g} m (standard "
            f"deviation), at distances of {range_m:.2g} m in the median, so it is probably wrong; "
            "check the ids, or map without them"
        )
    if contradicting is not None and not has_ids and contradicting > OUTLYING:
        return (
            f"\nWARNING: {100 * contradicting:.1f} % of the observations contradict the map: it "
            "may be wrong, as where most landmarks in view move, or many move slowly together"
        )
    if contradicting is not None and has_ids and contradicting > MISREAD:
        return (
            f"\nWARNING: {100 * contradicting:.0f} % of the observations contradict their ids or "
            "the map: it may be wrong; check the ids, or compare with a map without them"
        )
    if not refinement or refinement["converged"]:
        return ""
    suspects = "wrong ids, matches or odometry" if uses_odometry else "wrong ids or matches"
    return (
        "\nWARNING: the refinement did not converge, so the map is the best one found and may be "
        f"wrong; check for {suspects}, or compare with --no-refine"
    )
