"""A Gaussian mixture initialised with lines: a control for the wall-shaped component."""

from __future__ import annotations

import warnings

import numpy as np

from relmap.core.arrays import Floats, Ints

STEPS = 50


def gaussian_labels(xy: Floats, labels: Ints, seed: int) -> Ints:
    """Return the component (n,) of each point (n, 2) after EM started from given labels.

    scikit-learn's `GaussianMixture` with full covariances; -1 only if there was no line.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    k = int(labels.max(initial=-1)) + 1
    if k == 0:
        return labels
    parts = [xy[labels == j] for j in range(k)]
    floor = 1e-12 * float(np.ptp(xy)) ** 2 * np.eye(2)
    covariances = np.array([np.cov(part.T, bias=True) for part in parts]) + floor
    model = GaussianMixture(
        k,
        reg_covar=float(floor[0, 0]),
        max_iter=STEPS,
        weights_init=np.array([len(part) for part in parts]) / (labels >= 0).sum(),
        means_init=np.array([part.mean(axis=0) for part in parts]),
        precisions_init=np.linalg.inv(covariances),
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the limit of fifty steps was reached
        return np.asarray(model.fit_predict(xy), dtype=np.int64)
