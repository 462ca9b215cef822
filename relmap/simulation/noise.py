"""Noise of measurements and limits of arguments, shared by all simulated worlds."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError

Noise = Literal["gaussian", "uniform"]
"""Distribution of the noise; both have the same standard deviation."""


def draw_noise(
    noise: Noise, sigma: float, shape: tuple[int, ...], rng: np.random.Generator
) -> Floats:
    """Draw independent errors with mean 0 and standard deviation `sigma`."""
    if noise == "gaussian":
        return rng.normal(0.0, sigma, shape)
    half_width = np.sqrt(3) * sigma
    return rng.uniform(-half_width, half_width, shape)


def check_arguments(noise: str, sigma: float, seed: int, *limits: tuple[bool, str]) -> None:
    """Raise an error for arguments out of range.

    `noise`, `sigma`, `seed`: arguments common to all worlds; `*limits`, tuple of (bool, str):
    further conditions, with the message if violated. Raises `RelmapError` with the message of the
    first violated condition.
    """
    for holds, message in (
        *limits,
        (noise in get_args(Noise), f"noise is {noise!r}; it must be gaussian or uniform"),
        (0 <= sigma < 1e3, f"sigma is {sigma}; it must lie in [0, 1000) metres"),
        (seed >= 0, f"seed is {seed}; it must not be negative"),
    ):
        if not holds:
            raise RelmapError(message)
