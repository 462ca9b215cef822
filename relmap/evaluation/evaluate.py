"""Comparison of a result with the truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from relmap.datasets.base import ObservationLog
from relmap.evaluation.judged_path import OTHER_AXES, judge_path, judge_relations
from relmap.evaluation.landmarks import judge_landmarks
from relmap.evaluation.space import judge_planes
from relmap.evaluation.truth import Judged, Truth
from relmap.evaluation.walls import MatchedCorners, judge_corners, judge_walls, match_corners
from relmap.io.results import Result
from relmap.planes.walls.files import PlaneResult
from relmap.planes3d.files import Plane3dResult

OF_WALLS = ("wall_recall", "wall_precision", "doubled_length")
ONLY: dict[Judged, tuple[str, ...]] = {
    "points": ("landmark_rmse_m",),
    "planes": ("corner_rmse_m", *OF_WALLS, "relation_m", "relation_rad"),
    "planes3d": ("plane_recall", "plane_precision", "plane_rmse_m", "doubled_area"),
}
"""Figures specific to one variant."""


@dataclass(frozen=True)
class Evaluation:
    """The figures of one result; None if one is not available.

    Attributes
    ----------
    landmark_rmse_m, corner_rmse_m : float or None
        Error of the mapped static landmarks, or corners, after rigid alignment with the true ones.
    wall_recall, wall_precision, doubled_length : float or None
        Fractions of wall length; see `relmap.evaluation.walls.judge_walls`.
    plane_recall, plane_precision, plane_rmse_m, doubled_area : float or None
        Of planes in space; see `relmap.evaluation.space.judge_planes`.
    coverage : float or None
        Fraction of the static true landmarks or corners, seen in at least ten of the mapped
        iterations, that are in the map.
    landmarks_per_true : float or None
        Mapped landmarks or corners per matched true one; ideally 1.
    purity : float or None
        Fraction of observations whose true landmark is the most frequent one of their mapped
        landmark; for points.
    ate_m : float or None
        Absolute trajectory error: RMSE of the positions after rigid alignment.
    rpe_m : float or None
        Relative pose error between consecutive iterations: RMSE of the translation.
    relation_m, relation_rad : float or None
        Mean error against checked relations between poses.
    counts : dict
        Counts behind the figures: `false_corners` are mapped corners without a true one.
    notes : tuple of str
        Reasons for figures missing despite this truth, and what the others leave out.
    variant : "points", "planes" or "planes3d"
        The mapped variant.
    """

    landmark_rmse_m: float | None = None
    corner_rmse_m: float | None = None
    wall_recall: float | None = None
    wall_precision: float | None = None
    doubled_length: float | None = None
    plane_recall: float | None = None
    plane_precision: float | None = None
    plane_rmse_m: float | None = None
    doubled_area: float | None = None
    coverage: float | None = None
    landmarks_per_true: float | None = None
    purity: float | None = None
    ate_m: float | None = None
    rpe_m: float | None = None
    relation_m: float | None = None
    relation_rad: float | None = None
    counts: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    variant: Judged = "points"

    def as_dict(self) -> dict[str, Any]:
        """Return the figures of the variant by name, JSON serialisable."""
        others = [name for kind in ONLY if kind != self.variant for name in ONLY[kind]]
        left_out = (*others, "variant")
        return {name: value for name, value in asdict(self).items() if name not in left_out}


def evaluate(result: Result, truth: Truth, log: ObservationLog | None = None) -> Evaluation:
    """Compare a result with the truth.

    Parameters
    ----------
    result : Result
        Result of points, a `PlaneResult` or a `Plane3dResult`.
    truth : Truth
    log : ObservationLog, optional
        The log of points that was mapped; its ids are the true association. Without them the
        landmark figures are None, unless the association was known and the labels are ids.

    Returns
    -------
    Evaluation

    Raises
    ------
    RelmapError
        If the log is not the one that was mapped.
    """
    poses, true_poses, _ = truth.poses_of(result)
    of_path, reasons = judge_path(result, truth)
    figures: dict[str, Any] = {}
    counts: dict[str, int] = {"poses": len(poses)}
    notes: list[str] = []
    variant: Judged = "points"
    if isinstance(result, PlaneResult):
        variant = "planes"
        matched = match_corners(result.planes, truth, poses, true_poses)
        figures, counts, notes = judge_corners(result.planes, truth, true_poses, matched)
        motion = (matched.R, matched.t) if matched else None
        figures |= judge_walls(result.planes, truth, poses, true_poses, motion)
    elif isinstance(result, Plane3dResult):
        variant = "planes3d"
        turned = any(reason.startswith(OTHER_AXES) for reason in reasons)
        faces = None if turned else truth.faces
        figures = dict(judge_planes(result.planes, faces, poses, true_poses))
        if faces is not truth.faces:
            notes.append("no plane recall, precision and RMSE: true poses align the planes")
    else:
        figures, counts, notes = judge_landmarks(result, truth, log)
    of_relations, more = judge_relations(result, truth)
    figures |= of_path | of_relations
    return Evaluation(**figures, counts=counts, notes=(*notes, *reasons, *more), variant=variant)


def match_walls(result: PlaneResult, truth: Truth) -> MatchedCorners | None:
    """Pair the corners of walls with the true ones; see `match_corners`."""
    return match_corners(result.planes, truth, *truth.poses_of(result)[:2])
