"""`PlaneSegmenter`: from the points of a scan to planes, with scikit-learn's interface."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError, brief
from relmap.core.scan import checked_points
from relmap.segmentation.em.mixture import WallMixture, scan_area
from relmap.segmentation.ends.corners import Sharpened, meet, sharpen
from relmap.segmentation.ends.end_types import sensor_limits, type_ends
from relmap.segmentation.planes import Planes, make_planes
from relmap.segmentation.scanline.lines import LaserScan, is_ordered
from relmap.segmentation.space.levelling import require_upright
from relmap.segmentation.wall import BEGIN, END, EXACT_M, SHARE, UX, UY, WALL

METHODS = ("em", "ransac", "mixture", "ransac3d", "patches", "scanlines")
SPATIAL = ("ransac3d", "patches")
"""Methods that distinguish floors and ceilings from walls."""
DEFAULTS = {"method": None, "noise": None, "random_state": 0, "view_rad": None, "range_m": None}
SEEDS = 2**32
CHECKED = 5
"""Number of first scans that are checked for upright surfaces, or for the order of the beams."""
UNORDERED = (
    "the points of the first scans are not in the order of the beams, as a 2-D laser returns them; "
    "sort those of each scan by bearing, or choose the segmenter em, which needs no order"
)


class PlaneSegmenter:
    """Finds the vertical planes of a scan.

    Parameters
    ----------
    method : str, optional
        "em": EM of wall-shaped components started from lines, with the best corners; "ransac": only
        those lines, faster; "mixture": a Gaussian mixture started from them; "ransac3d" and
        "patches": open3d's sequential RANSAC and its planar patches, which distinguish floors and
        ceilings from walls; "scanlines": 2-D laser scans whose points are in the order of the
        beams. If omitted, "scanlines" for points (n, 2) and "em" for (n, 3).
    noise : float, optional
        Standard deviation of a point across its plane, metres; estimated from the scan by default.
    random_state : int
        Seed; the same scan and seed give bit-identical planes.
    view_rad : float, optional
        Horizontal field of view, radians, centred ahead. By default estimated from the largest
        bearing to either side, unless the beams of a laser go all round.
    range_m : float, optional
        Horizontal range of the sensor, metres. By default estimated if several walls end at the
        same maximum distance.

    Attributes
    ----------
    labels_ : (n,) int64
        Row of `planes_` for each point, -1 for none.
    planes_ : Planes
    noise_ : float
        Noise of the scan, metres, as given or estimated.
    """

    labels_: Ints
    planes_: Planes
    noise_: float

    def __init__(
        self,
        method: str | None = None,
        *,
        noise: float | None = None,
        random_state: int = 0,
        view_rad: float | None = None,
        range_m: float | None = None,
    ) -> None:
        """Store the parameters; `fit` checks them."""
        self.method = method
        self.noise = noise
        self.random_state = random_state
        self.view_rad = view_rad
        self.range_m = range_m
        self._checked = self._unordered = 0

    def __repr__(self) -> str:
        given = ", ".join(f"{k}={v!r}" for k, v in self.get_params().items() if v != DEFAULTS[k])
        return f"{type(self).__name__}({given})"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name, for scikit-learn's `clone`.

        Parameters
        ----------
        deep : bool
            Ignored: no parameter is an estimator.

        Returns
        -------
        dict
        """
        return {name: getattr(self, name) for name in DEFAULTS}

    def set_params(self, **params: Any) -> Self:
        """Set parameters by name.

        Parameters
        ----------
        **params
            New values.

        Raises
        ------
        RelmapError
            If there is no such parameter.
        """
        for name, value in params.items():
            if name not in DEFAULTS:
                known = ", ".join(DEFAULTS)
                raise RelmapError(f"PlaneSegmenter has no parameter {name!r}; it has {known}")
            setattr(self, name, value)
        return self

    def fit_predict(self, points: ArrayLike, y: object = None) -> Ints:
        """Segment one scan and return the plane of each point.

        Parameters
        ----------
        points, y
            As for `fit`.

        Returns
        -------
        (n,) int64
            `labels_`; -1 for points on no plane.
        """
        return self.fit(points).labels_

    def fit(self, points: ArrayLike, y: object = None) -> Self:
        """Segment one scan.

        The first five scans are checked: in space each for surfaces that are not upright, with
        "scanlines" all of them for the order of the beams.

        Parameters
        ----------
        points : (n, 3) or (n, 2) array_like, robot frame, metres
            The sensor is at the origin; points there, of rays without a return, are on no plane. A
            scan without points, or ``[]``, has no planes.
        y : object
            Ignored; passed by scikit-learn's pipelines.

        Raises
        ------
        RelmapError
            If a parameter or the shape is wrong, a coordinate is not finite, or the scan has too
            many surfaces that are not upright, such as floors, or no scan so far is in order.
        """
        xyz = checked_points(points, 0)
        method, returned = self._validated(xyz.shape[1]), xyz[:, 0] != 0
        for column in xyz.T[1:]:  # `any` takes five times as long
            returned |= column != 0
        xyz = xyz if returned.all() else xyz[returned]
        xy = np.ascontiguousarray(xyz[:, :2])
        if len(xyz) and self._checked < CHECKED:
            self._checked += 1
            if xyz.shape[1] == 3 and method not in SPATIAL:
                require_upright(xyz)
            self._unordered += method == "scanlines" and not is_ordered(xy)
            if self._unordered == CHECKED:
                raise RelmapError(UNORDERED)
        if len(xy) < 2 or not (xy[1:] != xy[0]).any():
            none = WallMixture(np.zeros((0, WALL)), self.noise or 0.0, 1.0, 1.0)
            sharp = meet(none, max(len(xy), 1))
            labels = np.full(len(xy), -1)
        else:
            sharp, labels = self._segment(method, xyz, xy)
        view_rad, in_order = self.view_rad, method == "scanlines" and len(xy) > 1
        if view_rad is None and in_order and LaserScan(xy).is_all_round:
            view_rad = 2 * np.pi
        labels, self.planes_ = planes_of(xyz, sharp, labels, view_rad, self.range_m)
        self.labels_ = np.full(len(returned), -1)
        self.labels_[returned] = labels
        self.noise_ = float(sharp.mixture.sigma)
        return self

    def _validated(self, d: int) -> str:
        method = self.method or ("scanlines" if d == 2 else "em")
        if method not in METHODS:
            raise RelmapError(f"method is {self.method!r}; it must be one of {', '.join(METHODS)}")
        if d == 2 and method in SPATIAL:
            raise RelmapError(f"method {method} needs points (n, 3); these are (n, 2)")
        for name in ("noise", "view_rad", "range_m"):
            value, may_be_zero = getattr(self, name), name == "noise"
            if value is not None and not _is_size(value, may_be_zero):
                least = "0 or more" if may_be_zero else "positive"
                raise RelmapError(f"{name} is {brief(value)}; it must be a finite number, {least}")
        if self.view_rad is not None and self.view_rad > 2 * np.pi + 1e-3:  # rounded
            raise RelmapError(f"view_rad is {self.view_rad!r}; it must be radians, 2 pi at most")
        seed: Any = self.random_state
        if seed is not None and not (isinstance(seed, int | np.integer) and 0 <= seed < SEEDS):
            raise RelmapError(
                f"random_state is {brief(seed)}; it must be a whole number, 0 to {SEEDS - 1}"
            )
        return method

    def _segment(self, method: str, xyz: Floats, xy: Floats) -> tuple[Sharpened, Ints]:
        """Return accurate walls and the wall of each point."""
        from relmap.segmentation.em import search
        from relmap.segmentation.scanline import lines

        if method == "scanlines":
            other = xy[1:] != xy[:-1]
            once = np.append(True, other[:, 0] | other[:, 1])
            xy = xy if once.all() else xy[once]
            scan = lines.LaserScan(xy, self.noise)
            mixture, labels = lines.scan_walls(scan)
            bounds = lines.first_and_last(labels)
            sharp = meet(lines.extend_to_beams(mixture, scan, bounds), len(xy))
            curved = lines.on_curves(mixture, xy, labels, bounds)
            hidden = lines.hidden_ends(scan, bounds) | curved
            joined = sharp.joined & ~curved
            labels = labels if len(xy) == len(once) else labels[np.cumsum(once) - 1]
            return Sharpened(sharp.mixture, sharp.spread, joined, hidden), labels
        rng = np.random.default_rng(self.random_state)
        if method == "em":
            mixture = search.fit_walls(xy, self.noise, rng)
            sharp = sharpen(mixture, search.part(xy, search.POLISHED, rng))
            labels = sharp.mixture.labels(xy)
            if mixture.repeat > 1:  # otherwise a single column of beams would form a wall
                solid = search.long_enough(sharp.mixture)
                solid &= search.seen_broad(sharp.mixture, xy, labels)
                labels[~np.append(solid, True)[labels]] = -1
            return sharp, labels
        labels, sigma = self._hard_labels(method, xyz, xy, rng)
        mixture = walls_of_labels(xy, labels, sigma)
        return meet(mixture, len(xy)), labels

    def _hard_labels(
        self, method: str, xyz: Floats, xy: Floats, rng: np.random.Generator
    ) -> tuple[Ints, float]:
        """Return the plane of each point by methods other than EM, and the noise."""
        from relmap.segmentation.alternatives import patch_labels, sequential_labels
        from relmap.segmentation.em.search import find_lines
        from relmap.segmentation.noise import beam_angle, window_noise

        if method == "patches":
            return patch_labels(xyz), self.noise or 0.0
        sigma = window_noise(xy, rng) if self.noise is None else max(self.noise, 1e-9)
        if method == "ransac3d":
            return sequential_labels(xyz, sigma, self.random_state), sigma
        _, labels = find_lines(xy, sigma, rng, beam_angle(xy))
        if method == "mixture":
            from relmap.segmentation.alternatives import gaussian_labels

            labels = gaussian_labels(xy, labels, self.random_state)
        return labels, sigma


def _is_size(value: Any, may_be_zero: bool) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return bool(0 < value < np.inf or (may_be_zero and value == 0))


def planes_of(
    xyz: Floats,
    sharp: Sharpened,
    labels: Ints,
    view_rad: float | None = None,
    range_m: float | None = None,
) -> tuple[Ints, Planes]:
    """Return consecutive labels, and the planes."""
    walls = sharp.mixture.walls
    ends = walls[:, None, :2] + walls[:, BEGIN : END + 1, None] * walls[:, None, UX : UY + 1]
    count = np.bincount(labels[labels >= 0], minlength=len(ends))
    # Far from the origin, rounding may cancel a whole length.
    long = (ends[:, 0] != ends[:, 1]).any(axis=1)
    kept = np.flatnonzero((count > 0) & long)
    number = np.full(len(ends) + 1, -1)
    number[kept] = np.arange(len(kept))
    labels, ends = number[labels], ends[kept]
    spread, joined, hidden = sharp.spread[kept], sharp.joined[kept], sharp.hidden[kept]
    turned = ends[:, 0, 0] * ends[:, 1, 1] < ends[:, 0, 1] * ends[:, 1, 0]
    for pair in (ends, spread, joined, hidden) if turned.any() else ():
        pair[turned] = pair[turned][:, ::-1]
    limits = sensor_limits(ends, spread, joined, view_rad, range_m)
    kind = type_ends(ends, spread, joined, limits, hidden)
    return labels, make_planes(xyz, labels, ends, kind, sharp.mixture.sigma)


def walls_of_labels(xy: Floats, labels: Ints, sigma: float) -> WallMixture:
    """Return walls through labelled points (n, 2), with the ends of blurred boxes."""
    from relmap.segmentation.em.moves import wall_through
    from relmap.segmentation.ends.end_kernels import box_extent

    walls = np.zeros((int(labels.max(initial=-1)) + 1, WALL))
    for k in np.unique(labels[labels >= 0]):
        own = np.ascontiguousarray(xy[labels == k])
        like = np.zeros(WALL)
        like[:4] = *own[0], 1.0, 0.0
        walls[k] = wall_through(own, like)
        t = (own - walls[k, :2]) @ walls[k, 2:4]
        low, high = box_extent(t, sigma)
        walls[k, BEGIN], walls[k, END] = low, max(high, low + EXACT_M)
        walls[k, SHARE] = len(own) / len(xy)
    return WallMixture(walls, sigma, 0.0, scan_area(xy, sigma))
