"""What it costs to trust receivers that are not exactly where they say."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa._validate import array
from imm_tdoa.bounds.fix import crlb
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.stations import Stations


def trusting_mse(
    stations: Stations,
    position: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    pairs: Any = "reference",
    velocity: Any = None,
    range_rate_sigma: Any = None,
    speed: float = 299792458.0,
    time: float = 0.0,
) -> Array:
    """Mean squared error of a fix that takes the declared station positions for true (§3.6).

    To first order C_0 + T Q_p T' (and the same for velocities), with C_0 = (J' Q^-1 J)^-1 the
    covariance that such a fix claims and T = C_0 J' Q^-1 J_p; never below `crlb`.

    Parameters
    ----------
    stations : Stations
        The receivers, with the errors they declare.
    position, velocity, toa_sigma, tdoa_sigma, pairs, range_rate_sigma, speed, time
        As in `crlb`.

    Returns
    -------
    (..., d, d) or (..., 2d, 2d)
        Mean squared error, m² (and m²/s, m²/s²).

    Raises
    ------
    ValueError
        As `crlb`; stations that declare no errors.

    References
    ----------
    K. C. Ho, X. Lu and L. Kovavisaruch, "Source localization using TDOA and FDOA measurements in
    the presence of receiver location errors: analysis and solution", IEEE Trans. Signal
    Processing 55(2), 684-696, 2007.
    """
    if stations.position_covariance is None and stations.velocity_covariance is None:
        raise ValueError("stations: expected a position_covariance or a velocity_covariance")
    trusted = attrs.evolve(stations, position_covariance=None, velocity_covariance=None)
    sigmas: dict[str, Any] = {"toa_sigma": toa_sigma, "tdoa_sigma": tdoa_sigma}
    C = crlb(
        trusted,
        position,
        velocity=velocity,
        range_rate_sigma=range_rate_sigma,
        pairs=pairs,
        speed=speed,
        time=time,
        **sigmas,
    )
    p = array("position", position)
    v = np.zeros_like(p) if velocity is None else array("velocity", velocity)

    def measurement(of: Stations) -> MeasurementModel:
        model: MeasurementModel = registry.load("tdoa")(of, pairs=pairs, speed=speed, **sigmas)
        if range_rate_sigma is None:
            return model
        fdoa = registry.load("fdoa")(of, range_rate_sigma=range_rate_sigma, pairs=pairs)
        stack: MeasurementModel = registry.load("stack")(model, fdoa)
        return stack

    claimed = measurement(trusted)
    H = np.concatenate(claimed.jacobian(p, v, time), axis=-1)[..., : C.shape[-1]]
    R = claimed.noise_covariance(p, v, time)
    true = measurement(stations).noise_covariance(p, v, time)
    heard = np.asarray(np.isfinite(H).all(axis=-1))
    kept = np.flatnonzero(claimed.independent(heard).reshape(-1, heard.shape[-1]).all(axis=0))
    H, rows = H[..., kept, :], (..., kept[:, None], kept)
    G = np.linalg.solve(R[rows], H) @ C
    result: Array = np.swapaxes(G, -1, -2) @ true[rows] @ G
    return 0.5 * (result + np.swapaxes(result, -1, -2))
