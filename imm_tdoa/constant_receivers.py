"""Tracking with receivers whose errors stay: estimated along with the emitter (ALGORITHMS §1.4).

Receiver errors that are new at every scan belong in the noise, where the measurement models put
what `Stations` declare. Errors that stay (a badly surveyed mast, a satellite's orbit over
minutes) do not average out; a filter that takes them for noise believes itself better with every
scan. Here they are constant components of every mode's state, s0x, s0y, ... in metres.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, gaussian
from imm_tdoa.augmentation import (
    Augmented,
    ConstantErrors,
    LinearAugmented,
    parts,
    receiver_jacobian,
)
from imm_tdoa.bank import Bank
from imm_tdoa.contract import AXES, Array, Index, LinearMotion, Mask, MeasurementModel
from imm_tdoa.cycle import UpdateRule
from imm_tdoa.imm import IMM
from imm_tdoa.initiation import velocity_std
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.scans import Scans
from imm_tdoa.state import State
from imm_tdoa.stations import Stations
from imm_tdoa.track import Track


@attrs.frozen(eq=False)
class ConstantReceivers:
    """An IMM for stations whose declared errors are the same at all times.

    Parameters
    ----------
    bank : Bank
        The motion models.
    measurement : MeasurementModel
        What is measured, by stations that declare a `position_covariance` (and, with range
        rates, perhaps a `velocity_covariance`). Their errors leave the noise and become
        components of the state.
    update : "ekf", "iekf", "ukf" or "ckf"
        As of `IMM`.

    Raises
    ------
    ValueError
        A measurement not made by stations, stations that declare no errors or that differ
        between the measurement's parts.

    Notes
    -----
    The rows are linear in the receivers' errors to first order; what is left out is an error
    squared over twice the range. Every target of a batch has errors of its own.

    Examples
    --------
    >>> track = ConstantReceivers(bank, TDOA(stations, toa_sigma=70e-9)).run(times, values)
    """

    bank: Bank
    measurement: MeasurementModel
    update: UpdateRule = attrs.field(default="ekf", kw_only=True)
    imm: IMM = attrs.field(init=False, repr=False)
    stations: Stations = attrs.field(init=False, repr=False)

    def __attrs_post_init__(self) -> None:
        stations = _stations(self.measurement)
        object.__setattr__(self, "stations", stations)
        names = _names(stations)
        models = [
            (LinearAugmented if isinstance(model, LinearMotion) else Augmented)(model, names)
            for model in self.bank.models
        ]
        bank = attrs.evolve(self.bank, models=models, names=self.bank.names)
        exact = _with_stations(self.measurement, _exact(stations))
        imm = IMM(bank, ConstantErrors(exact, stations), update=self.update)
        object.__setattr__(self, "imm", imm)

    def start(self, time: float | Array, values: Any) -> State:
        """Return the state at the fix that one scan gives, correlated with the receivers' errors.

        Parameters
        ----------
        time : float or (...)
            When, s.
        values : (..., m)
            What was measured; it is used up.

        Raises
        ------
        ValueError
            A scan that determines no position, or two.
        """
        values = _validate.array("values", values, (None, self.measurement.size), finite=False)
        time = np.broadcast_to(_validate.array("time", time), values.shape[:-1])
        d = self.stations.dims
        std = velocity_std(self.bank, self.bank.space(d))
        scan = Scans.checked(self.measurement, time[..., None], values[..., None, :])
        fix = fix_scans(scan, moving=std is not None, velocity_std=std)
        if not np.all(fix.converged) or fix.ambiguous:
            raise ValueError(
                "values: the first scan determines no position, or two; expected one that can be "
                "started from"
            )
        v = np.zeros_like(fix.position) if fix.velocity is None else fix.velocity
        x = fix.position if fix.velocity is None else np.concatenate([fix.position, v], axis=-1)
        nu, H, A, R = _differenced(self.measurement, fix.position, v, time, values)
        H = H[..., : x.shape[-1]]
        Q = _covariance(self.stations)
        W = np.linalg.inv(gaussian.factor(R, "noise covariance"))
        nu, H, A = np.einsum("...ij,...j->...i", W, nu), W @ H, W @ A
        AQ, C = A @ Q, fix.covariance
        G = np.swapaxes(H, -1, -2) @ AQ
        offset = np.einsum("...ik,...i->...k", AQ, nu)
        cross = -C @ G
        own = Q - np.swapaxes(AQ, -1, -2) @ AQ + np.swapaxes(G, -1, -2) @ C @ G
        P = np.concatenate(
            [
                np.concatenate([C, cross], axis=-1),
                np.concatenate([np.swapaxes(cross, -1, -2), own], axis=-1),
            ],
            axis=-2,
        )
        kinematic = AXES[:d] if std is None else (*AXES[:d], *(f"v{a}" for a in AXES[:d]))
        names = (*kinematic, *_names(self.stations))
        mean = np.concatenate([x, offset], axis=-1)
        return self.imm.start(time, mean, gaussian.symmetric(P), names)

    def run(self, times: Any, values: Any) -> Track:
        """Track through a whole recording, starting from the fix of the first scan.

        Parameters
        ----------
        times : (T,) or (..., T)
            Times of the scans, s, not decreasing.
        values : (..., T, m)
            Rows of each scan; NaN is missing.

        Returns
        -------
        Track
            Row 0 is the fix; the last components are the stations' errors, m.
        """
        scans = Scans.checked(self.measurement, times, values)
        state = self.start(scans.times[..., 0], scans.values[..., 0, :])
        rest = np.array(scans.values)
        rest[..., 0, :] = np.nan  # the fix has used it up
        return self.imm.run(scans.times, rest, start=state)

    def receivers(self, track: Track) -> tuple[Array, Array]:
        """Return where the stations truly are (..., T, S, d), m, and covariances (..., T, S, d, d).

        Parameters
        ----------
        track : Track
            What `run` returned.
        """
        S, d = len(self.stations), self.stations.dims
        first = track.space.components.index(_names(self.stations)[0])
        own = slice(first, first + S * d)
        error = track.mean[..., own].reshape(*track.mean.shape[:-1], S, d)
        P = track.covariance[..., own, own].reshape(*error.shape[:-2], S, d, S, d)
        spread = np.moveaxis(np.diagonal(P, axis1=-4, axis2=-2), -1, -3)
        return self.stations.at(track.times)[0] + error, spread


def _stations(measurement: Any) -> Stations:
    stations = [getattr(part, "stations", None) for part in parts(measurement)]
    if not all(isinstance(s, Stations) and s is stations[0] for s in stations):
        raise ValueError("measurement: expected one made by one set of stations")
    result: Stations = stations[0]  # type: ignore[assignment]
    if result.position_covariance is None:
        raise ValueError("measurement: expected stations that declare a position_covariance")
    return result


def _exact(stations: Stations) -> Stations:
    return attrs.evolve(stations, position_covariance=None, velocity_covariance=None)


def _with_stations(measurement: Any, stations: Stations) -> Any:
    own = [attrs.evolve(part, stations=stations) for part in parts(measurement)]
    return own[0] if not hasattr(measurement, "models") else type(measurement)(*own)


def _names(stations: Stations) -> tuple[str, ...]:
    each = [f"s{i}" for i in range(len(stations))]
    axes = AXES[: stations.dims]
    names = [f"{s}{a}" for s in each for a in axes]
    if stations.velocity_covariance is not None:
        names += [f"{s}v{a}" for s in each for a in axes]
    return tuple(names)


def _covariance(stations: Stations) -> Array:
    """Covariance (k, k) of the errors, in the order of `_names`."""
    blocks = [
        q for q in (stations.position_covariance, stations.velocity_covariance) if q is not None
    ]
    S, d = len(stations), stations.dims
    result = np.zeros((len(blocks) * S * d,) * 2)
    for i, q in enumerate(np.concatenate(blocks)):
        result[i * d : (i + 1) * d, i * d : (i + 1) * d] = q
    return result


def _differenced(
    measurement: MeasurementModel, position: Array, velocity: Array, time: Array, values: Array
) -> tuple[Array, Array, Array, Array]:
    """Innovation, Jacobians by kinematics and receivers, and R of the rows that count.

    Shared offsets are eliminated; rows that do not count are neutral.
    """
    stations = _stations(measurement)
    nu = values * measurement.scale - measurement.predict(position, velocity, time)
    H = np.concatenate(measurement.jacobian(position, velocity, time), axis=-1)
    A = receiver_jacobian(measurement, stations, position, velocity, time)
    R = measurement.noise_covariance(position, velocity, time)
    present: Mask = measurement.independent(np.isfinite(nu))
    R = np.broadcast_to(R, (*present.shape, R.shape[-1]))
    both = present[..., :, None] & present[..., None, :]
    group: Index = measurement.offset_group
    T, left = gaussian.offset_contrast(np.einsum("...ii->...i", R), present, group)
    J = T @ np.where(present[..., None], np.concatenate([H, A], axis=-1), 0.0)
    R = T @ np.where(both, R, 0.0) @ np.swapaxes(T, -1, -2)
    nu = np.einsum("...ij,...j->...i", T, np.where(present, nu, 0.0))
    nu, J, R = gaussian.mask_rows(nu, J, R, left)
    return nu, J[..., : H.shape[-1]], J[..., H.shape[-1] :], R
