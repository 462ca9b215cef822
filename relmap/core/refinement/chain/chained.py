"""Refinement by single observations and odometry: a chain of poses connects scans without overlap.

Odometry is one more relative location, weighted by its noise.  Its constant errors (of the scale,
and the turn missed per metre) are solved for with the map; its noise, and that of the observations,
is estimated from the residuals (variance components; Foerstner, 1979).
"""

from __future__ import annotations

from copy import copy
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.linalg.cholesky import Pattern
from relmap.core.motion_noise import unit_of
from relmap.core.refinement.chain.chain_data import Chain, Chained, Sigmas
from relmap.core.refinement.equations import BARELY, ROUNDING
from relmap.core.refinement.gauss_newton import size_of
from relmap.core.refinement.schur import NormalEquations

CONSTANT = 0.03
"""Prior standard deviation of the error of odometry's scale, and of the turn missed per metre."""

LARGEST = 10.0
"""Largest such error, in standard deviations: at a scale of zero any path fits odometry."""
SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")
LOOSE, STIFF = 1e-14, 1e3
"""Damping of all unknowns, and of the pose that defines the frame, relative to the largest diagonal
entry."""
WORST = 2.0
"""Maximum noise of odometry, relative to its estimate from landmarks.  If a scan shows one or two
landmarks, poses that fit these exactly, with noisy odometry, explain everything."""
FREE = 4.0
"""Minimum degrees of freedom of residuals from which a noise is estimated."""
LEAST = 1e-9
"""Smallest factor of a standard deviation: residuals may be exactly zero."""

Linear = tuple[Floats, Floats, Ints, Ints]
"""Residuals (n, r), their Jacobians (n, r, u), the unknowns (n, u), and their places (n, u, u) in
the matrix."""


class ChainProblem:
    """The residuals of observations and of odometry, in their standard deviations; a `Problem`.

    `step_sd`, tuple of (k - 1,): standard deviations of odometry: of a coordinate, metres, and of
    an angle, radians. `positions` (m, d), metres: approximate positions of the landmarks. `anchor`:
    the iteration whose pose defines the frame. `turns_whole`: whether a step that turns one part of
    the chain moves everything that depends on it, so that long chains bend in few steps. Otherwise
    each pose and landmark has its own shift. `slip`: how many times as far off as an observation
    a step of odometry must be to be an outlier.
    """

    def __init__(
        self,
        chain: Chain,
        step_sd: tuple[Floats, Floats],
        sigmas: Sigmas,
        positions: Floats,
        anchor: int,
        turns_whole: bool = True,
        slip: float = 1.0,
    ) -> None:
        self.turns_whole, self.slip, self.unit = turns_whole, slip, unit_of(chain.points)
        (n, d), m, k = chain.points.shape, len(positions), len(chain.motion) + 1
        q = 3 if d == 3 else 1
        self.chain, self._anchor, self._q, self._single_sd = chain, anchor, q, step_sd
        self.moved = np.flatnonzero(np.isfinite(chain.motion[:, 0, 0]))
        motion = chain.motion[self.moved]
        self._t, R = motion[:, :d, 3], motion[:, :3, :3]
        self._way = np.linalg.norm(self._t, axis=1)
        turn = Rotation.from_matrix(R).as_rotvec()
        self._turn = turn if d == 3 else turn[:, 2:]
        self._set_noise(sigmas, positions)
        n_tied = len(np.unique(np.concatenate([chain.iteration, self.moved, self.moved + 1])))
        self.freedoms = max(n * d + len(self.moved) * (d + q) - m * d - (n_tied - 1) * (d + q), 1)
        self.pattern = _pattern(chain, self.moved, m, k, d, q)
        first = self.pattern.first
        self.unknown = first[:m, None] + np.arange(d)
        self.pose = first[m : m + k, None] + np.arange(d + q)
        self._constant = first[-1] + np.arange(q + 2)
        self._square = np.full(self.pattern.n_unknowns, self.unit**2)
        self._square[self.pose[:, :q]] = self._square[self._constant[:2]] = 1.0
        self._square[self._constant[2:]] = self.unit**-2
        seen = self.pose[chain.iteration], self.unknown[chain.landmark]
        constant = np.broadcast_to(self._constant, (len(self.moved), q + 2))
        self._of_seen = np.concatenate(seen, axis=1)
        self._of_moved = np.concatenate(
            [self.pose[self.moved], self.pose[self.moved + 1], constant], axis=1
        )
        # The median iteration that saw each landmark.
        order = np.argsort(chain.landmark, kind="stable")
        begin, end = (np.searchsorted(chain.landmark[order], np.arange(m), of) for of in SIDES)
        self._base = chain.iteration[order][(begin + end) // 2]
        self._at_seen = self.pattern.places(self._of_seen)
        self._at_moved = self.pattern.places(self._of_moved)

    def with_noise(self, sigmas: Sigmas, positions: Floats) -> ChainProblem:
        """Return the problem with another noise; `positions` (m, d), metres: approximate."""
        problem = copy(self)
        problem._set_noise(sigmas, positions)
        return problem

    def _set_noise(self, sigmas: Sigmas, positions: Floats) -> None:
        way_m, turn_rad = (sd[self.moved] for sd in self._single_sd)
        self.sigmas, self._root = sigmas, self.chain.root / sigmas.seen
        self._latest: tuple[Chained, tuple[Linear, Linear]] | None = None
        self._step_sd = way_m * sigmas.way, turn_rad * sigmas.turn
        self.rounding = float(np.sum(self._root**2)) * (ROUNDING * size_of(positions)) ** 2

    @property
    def parts(self) -> tuple[slice, slice, slice]:
        """The residuals of observations, and of the distances and turns of odometry."""
        n, o = len(self.chain.points), len(self.moved)
        return slice(0, n), slice(n, n + o), slice(n + o, n + 2 * o)

    def residuals(self, state: Chained) -> Floats:
        """Return the norms of the residuals, in standard deviations, in the order of `parts`."""
        (seen, *_), (moved, *_) = self._linearised(state)
        parts = (seen, *np.split(moved, [seen.shape[1]], axis=1))
        return np.concatenate([np.linalg.norm(part, axis=1) for part in parts])

    def equations(
        self,
        state: Chained,
        weight: Floats,
        with_matrix: bool,
        damping: float,
        hold: tuple[float, float] = (0.0, LOOSE),
    ) -> NormalEquations:
        """Return the normal equations of all unknowns.

        `hold`: damping as a fraction of each diagonal entry, and of the largest one.
        """
        from relmap.core.linalg.cholesky_kernels import add_products

        pattern, right, cost = self.pattern, np.zeros(self.pattern.n_unknowns), 0.0
        matrix = np.zeros(pattern.size if with_matrix else 0)
        both = zip(self._linearised(state), self._weights(weight), strict=True)
        for (rows, jacobian, unknowns, at), each in both:
            pull = np.empty(unknowns.shape)
            add_products(jacobian, rows, each, at, matrix, pull)
            right -= np.bincount(unknowns.ravel(), pull.ravel(), minlength=len(right))
            cost += float(np.einsum("nr,nr,n->", rows, rows, each))
        variance = CONSTANT**2 * self._square[self._constant]
        right[self._constant] -= state.constant / variance
        if with_matrix:
            pattern.add_diagonal(matrix, self._constant, 1 / variance)
            share, least = hold
            largest = pattern.largest(matrix, self._square)
            pattern.hold(matrix, share + damping, least * largest / self._square)
            fixed, largest = self.pose[self._anchor], pattern.largest(matrix, self._square)
            pattern.add_diagonal(matrix, fixed, STIFF * largest / self._square[fixed])
        return NormalEquations(right, matrix, cost, lambda step: step[self.pose])

    def stepped(
        self, state: Chained, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Chained:
        """Return the state after a step.

        Positions follow from the steps between neighbours, so that a part of the chain turns as a
        whole: independent shifts would stretch it, and steps would have to be short.
        """
        moves = equations.eliminated_steps(step)
        turn, shift = moves[:, : self._q], moves[:, self._q :]
        R = rotations(turn) @ state.R
        most = LARGEST * CONSTANT * np.sqrt(self._square[self._constant])
        constant = np.clip(state.constant + step[self._constant], -most, most)
        if not self.turns_whole:
            return Chained(state.positions + step[self.unknown], R, state.t + shift, constant)

        def placed(base: Ints, points: Floats, moved: Floats) -> Floats:
            """Return points (n, d) after a small step, relative to the new poses of their bases."""
            away = points - state.t[base]
            own = np.einsum("nij,nj->ni", derivatives(away), moves[base])
            back = np.swapaxes(state.R[base], 1, 2)
            local = np.einsum("nij,nj->ni", back, away + moved - own)
            return np.asarray(np.einsum("nij,nj->ni", R[base], local))

        each = np.arange(len(R) - 1)
        t = np.concatenate([np.zeros((1, R.shape[1])), placed(each, state.t[1:], shift[1:])])
        t = np.cumsum(t, axis=0)
        t += state.t[self._anchor] + shift[self._anchor] - t[self._anchor]
        ways = placed(self._base, state.positions, step[self.unknown])
        return Chained(ways + t[self._base], R, t, constant)

    def odometry_squares(self, state: Chained, step: Floats) -> Floats:
        """Return by how much a small step (u,) of the unknowns changes each motion (o,), squared.

        In standard deviations.
        """
        jacobian = self._linearised(state)[1][1]
        change = np.einsum("nij,nj->ni", jacobian, step[self._of_moved])
        return np.asarray(np.sum(change**2, axis=1))

    def inverse(self, state: Chained, weight: Floats) -> Floats:
        """Return the covariances of all coupled unknowns, in the layout of the pattern."""
        return self.pattern.inverse(self.factor(state, weight))

    def factor(self, state: Chained, weight: Floats) -> Floats:
        """Return the Cholesky factor of the matrix at the optimum.

        The largest entry is that of a turn, whose unit is another than that of positions.
        """
        matrix = self.equations(state, weight, True, 0.0, (BARELY, 0.0)).matrix
        self.pattern.factorise(matrix)
        return matrix

    def covariances(self, state: Chained, weight: Floats) -> Floats:
        """Return the covariances (m, d, d) of the landmarks."""
        return self.pattern.parts(self.inverse(state, weight), self.unknown)

    def components(self, state: Chained, weight: Floats) -> Sigmas:
        """Return the standard deviations from the residuals of each kind and their freedoms."""
        from relmap.core.linalg.cholesky_kernels import add_products

        inverse, sums, d = self.inverse(state, weight), [], self.chain.points.shape[1]
        one, two = zip(self._linearised(state), self._weights(weight), strict=True)
        for (linear, each), of in (one, slice(d)), (two, slice(d)), (two, slice(d, None)):
            rows, jacobian = (np.ascontiguousarray(part[:, of]) for part in linear[:2])
            sure, products = np.asarray(each == 1, np.float64), np.zeros_like(inverse)
            add_products(jacobian, rows, sure, linear[3], products, np.empty(linear[2].shape))
            free = rows.shape[1] * sure.sum() - self.pattern.trace(products, inverse)
            sums.append((sure @ np.sum(rows**2, axis=1), free))
        factors = [np.sqrt(squares / free) if free > FREE else 1.0 for squares, free in sums]
        both = zip(self.sigmas, factors, strict=True)
        seen, way, turn = (max(float(old * new), LEAST) for old, new in both)
        return Sigmas(seen, min(way, WORST), min(turn, WORST))

    def _weights(self, weight: Floats) -> tuple[Floats, Floats]:
        """Return those of observations, and of steps: a slip makes both parts of one wrong."""
        seen, way, turn = (weight[part] for part in self.parts)
        return seen, np.minimum(way, turn)

    def _linearised(self, state: Chained) -> tuple[Linear, Linear]:
        """Return residuals, Jacobians, unknowns and matrix positions, of both kinds.

        Those of the last state are cached.
        """
        if self._latest is None or self._latest[0] is not state:
            seen = *self._left_of_seen(state), self._of_seen, self._at_seen
            moved = *self._left_of_odometry(state), self._of_moved, self._at_moved
            self._latest = state, (seen, moved)
        return self._latest[1]

    def _left_of_seen(self, state: Chained) -> tuple[Floats, Floats]:
        """Return the residuals (n, d) of observations, and their Jacobian."""
        from relmap.core.refinement.chain.chain_kernels import left_of_seen

        points, landmark, iteration = self.chain[:3]
        seen = points, self._root, iteration, landmark
        left, jacobian = np.empty(points.shape), np.empty((*points.shape, self._of_seen.shape[1]))
        R, t, positions = map(np.ascontiguousarray, (state.R, state.t, state.positions))
        left_of_seen(seen, R, t, positions, left, jacobian)
        return left, jacobian

    def _left_of_odometry(self, state: Chained) -> tuple[Floats, Floats]:
        """Return the residuals (o, d + q) of distances and turns, and their Jacobian."""
        a, d, q = self.moved, self._t.shape[1], self._q
        R_a, R_b = state.R[a], state.R[a + 1]
        back, between = np.swapaxes(R_a, 1, 2), state.t[a + 1] - state.t[a]
        scale, turn_scale, per_m = 1 + state.constant[0], 1 + state.constant[1], state.constant[2:]
        went, turned = np.einsum("nij,nj->ni", back, between), _angles(back @ R_b)
        off_way = scale * went - self._t
        missed = rotations(self._turn + self._way[:, None] * per_m)
        off_turn = _angles(np.swapaxes(missed, 1, 2) @ rotations(turn_scale * turned))
        jacobian = np.zeros((len(a), d + q, 2 * (d + q) + q + 2))
        jacobian[:, :d, : d + q] = -scale * (back @ derivatives(between))
        jacobian[:, :d, d + 2 * q : 2 * (d + q)] = scale * back
        jacobian[:, :d, 2 * (d + q)] = went
        by_turn = np.swapaxes(R_b, 1, 2) if q == 3 else np.ones((len(a), 1, 1))
        by_turn = turn_scale * by_turn
        jacobian[:, d:, :q], jacobian[:, d:, d + q : d + 2 * q] = -by_turn, by_turn
        jacobian[:, d:, 2 * (d + q) + 1] = turned
        jacobian[:, d:, 2 * (d + q) + 2 :] = -self._way[:, None, None] * np.eye(q)
        way, angle = self._step_sd[0][:, None], self._step_sd[1][:, None]
        jacobian[:, :d] /= way[:, None]
        jacobian[:, d:] /= angle[:, None]
        return np.concatenate([off_way / way, off_turn / angle], axis=1), jacobian


def _angles(R: Floats) -> Floats:
    """Return the angles (n, 1) or rotation vectors (n, 3) of rotations (n, d, d)."""
    if R.shape[1] == 3:
        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    return np.arctan2(R[:, 1, 0], R[:, 0, 0])[:, None]


def _pattern(chain: Chain, moved: Ints, m: int, k: int, d: int, q: int) -> Pattern:
    """Return the pattern of landmarks, poses and constant errors, ordered for little fill-in."""
    width = np.concatenate([np.full(m, d), np.full(k, d + q), [q + 2]])
    every, o = np.arange(m + k + 1), len(moved)
    group = [*[chain.iteration] * 2, *[k + np.arange(o)] * 3, k + o + every]
    seen, steps = (chain.landmark, m + chain.iteration), (m + moved, m + moved + 1)
    block = [*seen, *steps, np.full(o, m + k), every]
    return Pattern.of_pairs(width, np.concatenate(group), np.concatenate(block))
