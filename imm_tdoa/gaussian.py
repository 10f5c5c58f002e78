"""One Gaussian: predict, update, log-density (ALGORITHMS §4).

Pure functions on arrays with leading batch axes. A missing row is a False in `present`: the row
leaves the computation exactly, as if it had been cut out of z, h, H and R, without ragged shapes.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index, Mask

LOG_2PI = float(np.log(2.0 * np.pi))
ROUNDING = (1e-13, 1e-11, 1e-9)  # of a sum of products, the more terms cancelled the larger


class Update(NamedTuple):
    """What a measurement made of a Gaussian; see `update`."""

    x: Array
    P: Array
    log_likelihood: Array
    nis: Array


def symmetric(P: Array) -> Array:
    """Return (P + P') / 2."""
    result: Array = 0.5 * (P + np.swapaxes(P, -1, -2))
    return result


def predict_covariance(P: Array, F: Array, Q: Array) -> Array:
    """Return F P F' + Q, exactly symmetric.

    Parameters
    ----------
    P : (..., n, n)
        Covariance before.
    F : (..., k, n)
        Transition.
    Q : (..., k, k)
        Process noise.
    """
    return symmetric(F @ P @ np.swapaxes(F, -1, -2) + Q)


def wrap(angle: Array) -> Array:
    """Return `angle` (rad) wrapped into [-pi, pi)."""
    result: Array = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return result


def offset_contrast(variance: Array, present: Mask, group: Index) -> tuple[Array, Mask]:
    """Return the matrix T (..., m, m) that differences shared offsets away, and what remains.

    Within each group the present row of least variance becomes the reference: it is subtracted
    from the group's other rows and leaves (§1.1, reference-free information). What remains says
    exactly what the group says about the state, and has the same likelihood, whichever row was
    taken.

    Parameters
    ----------
    variance : (..., m)
        Noise variances of the rows.
    present : (..., m)
        Rows that were measured.
    group : (m,)
        Offset group of each row; -1: none.
    """
    eye = np.eye(len(group))
    T = eye
    for g in np.unique(group[group >= 0]):
        members = group == g
        least = np.argmin(np.where(present & members, variance, np.inf), axis=-1)[..., None]
        reference = present & members & (np.arange(len(group)) == least)
        T = T - np.where(members, 1.0, 0.0)[:, None] * np.where(reference, 1.0, 0.0)[..., None, :]
        present = present & ~reference
    return T, present


def mask_rows(nu: Array, H: Array, R: Array, present: Mask) -> tuple[Array, Array, Array]:
    """Neutralise missing rows: zero innovation and Jacobian, unit variance, no correlation.

    Parameters
    ----------
    nu : (..., m)
        Innovation; anything where missing.
    H : (..., m, n)
        Jacobian.
    R : (..., m, m)
        Noise covariance.
    present : (..., m)
        Rows that were measured.

    Returns
    -------
    nu, H, R
        The same rows, to be updated with as if all were there.
    """
    both = present[..., :, None] & present[..., None, :]
    R = np.where(both, R, np.eye(R.shape[-1]))
    return np.where(present, nu, 0.0), np.where(present[..., None], H, 0.0), R


def factor(S: Array, what: str = "innovation covariance") -> Array:
    """Return the lower Cholesky factor of S (..., m, m), or say which covariance failed.

    Parameters
    ----------
    S : (..., m, m)
        Symmetric and positive definite.
    what : str
        What the message calls it.

    Raises
    ------
    ValueError
        `S` is not positive definite.
    """
    try:
        return np.asarray(np.linalg.cholesky(S), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"{what}: not positive definite") from error


def innovation_factor(S: Array, R: Array | None = None) -> Array:
    """Return the lower Cholesky factor of S = H P H' + R (..., m, m).

    With a prediction so diffuse that R is lost in rounding, S may come out indefinite although
    `R` (if it is given) is not: then it is lifted by the rounding of its own entries.

    Parameters
    ----------
    S : (..., m, m)
        Innovation covariance.
    R : (..., m, m), optional
        Noise covariance in it.

    Raises
    ------
    ValueError
        Neither `S` nor the lifted one is positive definite, or `R` is not.
    """
    try:
        return factor(S)
    except ValueError:
        if R is not None:
            factor(R, "innovation covariance")
        own = np.eye(S.shape[-1]) * S
        for rounding in ROUNDING[:-1]:
            with suppress(ValueError):
                return factor(S + rounding * own)
        return factor(S + ROUNDING[-1] * own)


def update(x: Array, P: Array, nu: Array, H: Array, R: Array, present: Mask) -> Update:
    """Kalman update in Joseph form with innovation `nu`; log-likelihood from the factor of S.

    Parameters
    ----------
    x : (..., n)
        Predicted mean.
    P : (..., n, n)
        Predicted covariance.
    nu : (..., m)
        Innovation z - h(x), angular rows wrapped.
    H : (..., m, n)
        Jacobian of h at x.
    R : (..., m, m)
        Noise covariance.
    present : (..., m)
        Rows that were measured; the others change nothing.

    Returns
    -------
    Update
        Mean, covariance, log-likelihood of the present rows and normalised innovation squared.
    """
    nu, H, R = mask_rows(nu, H, R, present)
    HP = H @ P
    S = symmetric(HP @ np.swapaxes(H, -1, -2) + R)
    L = innovation_factor(S, R)
    white = np.linalg.solve(L, np.concatenate([HP, nu[..., None]], axis=-1))
    A, w = white[..., :-1], white[..., -1]
    K = np.swapaxes(np.linalg.solve(np.swapaxes(L, -1, -2), A), -1, -2)
    x = x + np.einsum("...ij,...j->...i", K, nu)
    I_KH = np.eye(P.shape[-1]) - K @ H
    P = symmetric(I_KH @ P @ np.swapaxes(I_KH, -1, -2) + K @ R @ np.swapaxes(K, -1, -2))
    nis = np.einsum("...i,...i->...", w, w)
    log_det = 2.0 * np.sum(np.log(np.einsum("...ii->...i", L)), axis=-1)
    rows = np.count_nonzero(present, axis=-1)
    return Update(x, P, -0.5 * (nis + log_det + rows * LOG_2PI), nis)
