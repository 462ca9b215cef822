"""Noise of simulated measurements."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Noise = Literal["gaussian", "uniform"]
"""Distribution of the noise; both have the same standard deviation."""


def draw_noise(
    noise: Noise, sigma: float, shape: tuple[int, ...], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw independent errors with mean 0 and standard deviation `sigma`."""
    if noise == "gaussian":
        return rng.normal(0.0, sigma, shape)
    half_width = np.sqrt(3) * sigma
    return rng.uniform(-half_width, half_width, shape)
