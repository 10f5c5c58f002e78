"""From a bank to filterpy's Kalman filters."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from imm_tdoa import _validate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, LinearMotion, MeasurementModel
from imm_tdoa.interop.linear import linear_rows
from imm_tdoa.state import State


class KalmanBank(NamedTuple):
    """A bank as filterpy knows it; see `to_filterpy`.

    Attributes
    ----------
    filters : list of filterpy.kalman.KalmanFilter
        One per mode, each in its own mode's components.
    mode_probability : (r,)
        filterpy's ``mu``.
    transition : (r, r)
        filterpy's ``M``; **rows** sum to one.
    """

    filters: list[Any]
    mode_probability: Array
    transition: Array


def to_filterpy(
    bank: Bank, measurement: MeasurementModel, dt: float, state: State | None = None
) -> KalmanBank:
    """Return filterpy objects for a bank of linear models with a linear measurement.

    Each mode becomes a ``filterpy.kalman.KalmanFilter`` with F, Q over steps of `dt`, H, R, and
    x (n, 1), P of the `state`. Components keep their order and each mode its own number of them;
    nothing is padded. H and R are in the units of the measurement's values.

    Parameters
    ----------
    bank : Bank
        Models that are linear.
    measurement : MeasurementModel
        Rows linear in position and velocity, such as `Position` or `LinearMeasurement`.
    dt : float
        Time step of all scans, s.
    state : State, optional
        Where the filters stand (of one target). Default: filterpy's own, x = 0 and P = I, with
        the bank's prior probabilities.

    Returns
    -------
    KalmanBank
        Filters, mode probabilities and transition matrix.

    Raises
    ------
    ValueError
        A model or measurement that is not linear, a time step that is not positive, a state of
        another bank or of several targets.

    Notes
    -----
    filterpy 2.0's `IMMEstimator` documents ``M[i, j]`` as the probability of switching from j to
    i, and computes ``mu @ M``: what it really takes is the matrix given here, whose rows sum to
    one. It takes modes of equal dimension only, and its constructor mixes once; each scan is
    then ``predict()`` and ``update(z)``, exactly as often as there are scans, with every scan
    measured::

        filters, mu, M = to_filterpy(bank, measurement, dt, state)
        imm = filterpy.kalman.IMMEstimator(filters, mu, M)
        imm.predict()
        imm.update(z)

    With these conditions it computes what `IMM` does. Without them it does not: a missed
    measurement is scored with the last likelihoods, a second update at one instant applies the
    chain again, one outlier resets the probabilities.
    """
    if not isinstance(bank, Bank):
        raise ValueError(f"bank: expected a Bank, got {bank!r}")
    if isinstance(measurement, type) or not isinstance(measurement, MeasurementModel):
        raise ValueError(f"measurement: no measurement model: {measurement!r}")
    dt = _validate.positive("dt", dt)
    space = bank.space(measurement.dims)
    if state is not None:
        _refuse_foreign(state, bank, measurement.dims)
    H, R = linear_rows(measurement, 0.0 if state is None else float(state.time))
    d = space.dims
    filters = []
    for j, (model, names) in enumerate(zip(bank.models, space.modes, strict=True)):
        if not isinstance(model, LinearMotion):
            raise ValueError(f"bank: mode {bank.names[j]!r} is not linear, a KalmanFilter is")
        kf = KalmanFilter(dim_x=len(names), dim_z=len(H))
        kf.F = np.array(model.transition(dt, d))
        kf.Q = np.array(model.process_noise(dt, d))
        kf.H[:, space.position[j]] = H[:, :d]
        if len(space.velocity[j]):
            kf.H[:, space.velocity[j]] = H[:, d:]
        kf.R = R.copy()
        if state is not None:
            kf.x = np.array(state.means[j])[:, None]
            kf.P = np.array(state.covariances[j])
        filters.append(kf)
    probability = bank.prior if state is None else state.mode_probability
    return KalmanBank(filters, np.array(probability), np.array(bank.chain(dt)))


def _refuse_foreign(state: Any, bank: Bank, dims: int) -> None:
    if not isinstance(state, State) or state.space.modes != bank.space(dims).modes:
        raise ValueError("state: expected a state of this bank's modes, as IMM.start makes it")
    batch = state.log_mode_probability.shape[:-1]
    if batch:
        raise ValueError(f"state: expected one target, got a batch of shape {batch}")
