"""Odometry factors between poses in the refinement, where walls do not determine the motion.

Poses are eliminated one by one, but a factor involves two. So it is split into two factors with
half the variance each, which connect both poses to an auxiliary pose that is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.schur import Linearised
from relmap.planes.motions import wrapped


@dataclass(frozen=True, eq=False)
class MotionFactors:
    """Odometry factors between pairs of iterations; l pairs.

    `both` (l, 2): the earlier and the later one; `motion` (l, 3): pose of the later in the frame of
    the earlier: yaw, x, y; `sd` (l, 2): standard deviations of the yaw, radians, and of x and y,
    metres.
    """

    both: Ints = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    motion: Floats = field(default_factory=lambda: np.empty((0, 3)))
    sd: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def __len__(self) -> int:
        return len(self.both)

    def and_those(self, more: MotionFactors) -> MotionFactors:
        """Return these factors and others."""
        motion = np.concatenate([self.motion, more.motion])
        sd = np.concatenate([self.sd, more.sd])
        return MotionFactors(np.concatenate([self.both, more.both]), motion, sd)

    @property
    def iteration(self) -> Ints:
        """Iteration of each residual, (6 l,): yaw, x, y of the earlier, then the later."""
        return np.repeat(self.both.T, 3)

    @property
    def residual_sd(self) -> Floats:
        """Standard deviation of each residual, (6 l,)."""
        return np.tile(self.sd[:, [0, 1, 1]].ravel() / np.sqrt(2), 2)

    def added_to(self, seen: Linearised, yaw: Floats, t: Floats) -> Linearised:
        """Append residuals and Jacobians of the factors.

        The Jacobians are by the pose and by the auxiliary pose, which is midway between the two.
        `yaw` (i,) and `t` (i, 2) are of all poses.
        """
        earlier, later = self.both.T
        c, s = np.cos(yaw[earlier]), np.sin(yaw[earlier])
        x, y = self.motion[:, 1:].T
        led = np.column_stack([c * x - s * y, s * x + c * y])
        turn = wrapped(yaw[earlier] + self.motion[:, 0] - yaw[later])
        off = np.column_stack([turn, t[earlier] + led - t[later]]).ravel() / 2
        by_later = np.tile(np.eye(3), (len(self), 1, 1))
        by_earlier = by_later.copy()
        by_earlier[:, 1, 0], by_earlier[:, 2, 0] = -led[:, 1], led[:, 0]
        by_pose = np.concatenate([by_earlier, by_later]).reshape(-1, 3)
        by_kept = np.tile([-1.0, 0.0], (len(by_pose), 1))
        return Linearised(
            np.concatenate([seen.off, off, -off]),
            np.concatenate([seen.by_eliminated, by_pose]),
            np.concatenate([seen.by_kept, by_kept]),
        )
