"""Weighted Gaussians: the one idea that carries the IMM, model selection and Gaussian sums.

A mixture has a fixed number of slots, so that mixtures of different numbers of components make
one batch: an empty slot has the log weight -inf.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index

Distance = Literal["euclidean", "mahalanobis"]


class Mixture(NamedTuple):
    """Weighted Gaussians.

    Attributes
    ----------
    log_weight : (..., N)
        Logs of the weights; -inf is an empty slot.
    x : (..., N, n)
        Means.
    P : (..., N, n, n)
        Covariances.
    """

    log_weight: Array
    x: Array
    P: Array


def normalise(log_weight: Array) -> tuple[Array, Array]:
    """Return log weights (..., N) that sum to one, and the log of their former sum (...).

    Where every weight is zero the logs stay -inf and so does the sum.

    Parameters
    ----------
    log_weight : (..., N)
        Logs of weights; -inf is legal.
    """
    top = np.max(log_weight, axis=-1, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    shifted = log_weight - top
    with np.errstate(divide="ignore"):
        rest = np.log(np.sum(np.exp(shifted), axis=-1, keepdims=True))
    return shifted - np.where(np.isfinite(rest), rest, 0.0), (rest + top)[..., 0]


def moments(weight: Array, x: Array, P: Array) -> tuple[Array, Array]:
    """Mean (..., n) and covariance (..., n, n) of a mixture, spread of the means included.

    Parameters
    ----------
    weight : (..., N)
        Weights that sum to one.
    x : (..., N, n)
        Component means.
    P : (..., N, n, n)
        Component covariances.
    """
    mean = np.einsum("...i,...ia->...a", weight, x)
    d = x - mean[..., None, :]
    spread = P + d[..., :, None] * d[..., None, :]
    covariance = np.einsum("...i,...iab->...ab", weight, spread)
    return mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


def prune(log_weight: Array, below: float) -> Array:
    """Return log weights (..., N) that sum to one, shares under `below` dropped (-inf).

    The heaviest always stays, so that a mixture never becomes empty.

    Parameters
    ----------
    log_weight : (..., N)
        Logs of weights, of any sum.
    below : float
        Share of the whole that is dropped.

    Raises
    ------
    ValueError
        `below` is no share, 0 to less than 1.
    """
    if not _validate.non_negative("below", below) < 1.0:
        raise ValueError(f"below: expected a share of the weight, 0 to less than 1, got {below!r}")
    share, _ = normalise(log_weight)
    with np.errstate(divide="ignore"):
        least = np.minimum(np.log(below), np.max(share, axis=-1, keepdims=True))
    return normalise(np.where(share < least, -np.inf, share))[0]


def merge(
    mixture: Mixture,
    within: float,
    by: Distance = "euclidean",
    components: Index | None = None,
) -> Mixture:
    """Merge components that are closer than `within`, the closest pair first, moments kept.

    Two components become the one with their weight, mean and covariance (Alspach & Sorenson
    1972; ALGORITHMS §7.1-6), in the heavier's slot; the other's is empty then. This goes on until
    no pair is closer, so merging again changes nothing, and the order of the slots does not
    matter.

    Parameters
    ----------
    mixture : Mixture
        The components, N slots.
    within : float
        Distance under which two components are merged.
    by : "euclidean" or "mahalanobis"
        ``"euclidean"``: of the means, in their units (Source C's 3 km). ``"mahalanobis"``: the
        square root of w_i w_j / (w_i + w_j) d' P_i^-1 d, i the heavier of the two (Salmond 1990),
        which also measures how little a light component is missed; without units.
    components : (c,) int, optional
        State components that the Euclidean distance is over; default all.

    Raises
    ------
    ValueError
        A distance that is not positive, or an unknown kind of distance.
    """
    within = _validate.positive("within", within)
    _validate.one_of("by", by, get_args(Distance))
    N, n = mixture.x.shape[-2:]
    batch = np.broadcast_shapes(
        mixture.log_weight.shape[:-1], mixture.x.shape[:-2], mixture.P.shape[:-3]
    )
    w = np.array(np.broadcast_to(mixture.log_weight, (*batch, N))).reshape(-1, N)
    x = np.array(np.broadcast_to(mixture.x, (*batch, N, n))).reshape(-1, N, n)
    P = np.array(np.broadcast_to(mixture.P, (*batch, N, n, n))).reshape(-1, N, n, n)
    rows = np.arange(len(w))
    while len(rows):
        apart = _distances(Mixture(w[rows], x[rows], P[rows]), by, components)
        closest = np.argmin(apart.reshape(-1, N * N), axis=-1)
        close = apart.reshape(-1, N * N)[np.arange(len(rows)), closest] < within
        rows = rows[close]
        i, j = np.divmod(closest[close], N)
        heavy, light = np.where(w[rows, i] >= w[rows, j], [i, j], [j, i])
        pair = np.stack([heavy, light], axis=-1)
        share, total = normalise(w[rows[:, None], pair])
        x[rows, heavy], P[rows, heavy] = moments(
            np.exp(share), x[rows[:, None], pair], P[rows[:, None], pair]
        )
        w[rows, heavy], w[rows, light] = total, -np.inf
    return Mixture(w.reshape(*batch, N), x.reshape(*batch, N, n), P.reshape(*batch, N, n, n))


def _distances(mixture: Mixture, by: Distance, components: Index | None) -> Array:
    """Distances (B, N, N) between components; infinite to itself and to empty slots."""
    x, P = mixture.x, mixture.P
    w, _ = normalise(mixture.log_weight)
    N = w.shape[-1]
    empty = np.isneginf(w)
    never = empty[:, :, None] | empty[:, None, :] | np.eye(N, dtype=bool)
    d = x[:, :, None, :] - x[:, None, :, :]
    if by == "euclidean":
        d = d if components is None else d[..., components]
        return np.where(never, np.inf, np.sqrt(np.sum(d * d, axis=-1)))
    with np.errstate(invalid="ignore"):  # an empty slot against another
        more = w[:, :, None] - w[:, None, :]
    W = np.linalg.inv(np.where(empty[..., None, None], np.eye(x.shape[-1]), P))
    square = np.einsum("zija,ziab,zijb->zij", d, W, d, optimize=True)  # by the first's covariance
    other = np.swapaxes(square, -1, -2)
    square = np.where(more > 0.0, square, np.where(more < 0.0, other, np.minimum(square, other)))
    share = np.exp(w)
    both = share[:, :, None] + share[:, None, :]
    lost = share[:, :, None] * share[:, None, :] / np.where(both > 0.0, both, 1.0)
    return np.where(never, np.inf, np.sqrt(lost * square))
