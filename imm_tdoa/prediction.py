"""From one time to the next: a mode predicted by its own motion model (ALGORITHMS §9.1 step 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa import gaussian, sigma_points
from imm_tdoa.contract import Array, LinearMotion, MotionModel


class Prediction(NamedTuple):
    """A Gaussian a step later.

    Attributes
    ----------
    x : (..., n)
        Mean.
    P : (..., n, n)
        Covariance.
    cross : (..., n, n)
        Covariance of the state before with the state after, P F'; smoothing needs it.
    """

    x: Array
    P: Array
    cross: Array


def predict(
    model: MotionModel,
    x: Array,
    P: Array,
    dt: Array,
    dims: int,
    rule: sigma_points.Rule | None = None,
) -> Prediction:
    """Predict N(x, P) by `dt` (...) s.

    Linearised at the mean, or over the sigma points of `rule`; for a linear model these are the
    same and the plain form is used.

    Parameters
    ----------
    model : MotionModel
        How it moves.
    x, P : (..., n), (..., n, n)
        The state.
    dt : (...)
        Time step, s.
    dims : int
        Space dimensions.
    rule : "ukf", "ckf" or None
        Sigma points; None: linearised at the mean.
    """
    Q = model.process_noise(dt, dims)
    if rule is None or isinstance(model, LinearMotion):
        mean, F = model.propagate(x, dt), model.jacobian(x, dt)
    else:
        step = np.asarray(dt)[..., None]
        mean, F, rest = sigma_points.fit(lambda s: model.propagate(s, step), x, P, rule)
        Q = Q + rest
    return Prediction(mean, gaussian.predict_covariance(P, F, Q), P @ np.swapaxes(F, -1, -2))
