"""Laws of difference models: no station is special (ALGORITHMS §1.1)."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.testing.compare import agree
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import law
from imm_tdoa.testing.measurement_structure import Measured, rows_of
from imm_tdoa.testing.strategies import Kinematics, present_rows

SHARED = ("toa_sigma", "range_rate_sigma")


def _unshared(subject: Measured) -> str:
    model = subject.model
    if not hasattr(model, "pairs") or not hasattr(model, "stations"):
        return "rows are no differences between stations"
    if not any(getattr(model, name, None) is not None for name in SHARED):
        return f"noise is not given per station (none of {', '.join(SHARED)})"
    return "" if len(model.stations) >= 2 else "there is only one station"


def _against(stations: Index, reference: int) -> Index:
    """Pairs (n - 1, 2) of some stations against one of them."""
    return np.array([[i, reference] for i in stations if i != reference], dtype=np.int64)


def _information(model: Any, k: Kinematics) -> tuple[Array, Array]:
    """H' R^-1 H (2d, 2d) over position and velocity, and the magnitude of what it sums."""
    H = np.concatenate(model.jacobian(*k), axis=-1)
    W = np.linalg.inv(np.asarray(model.noise_covariance(*k), dtype=float))
    return H.T @ W @ H, np.abs(H).T @ np.abs(W) @ np.abs(H)


@law(
    "reference",
    "the information H' R^-1 H of any stations' differences is the same for every reference",
    exempt=_unshared,
)
def reference(subject: Measured, draw: Draw) -> None:
    """A full R makes the choice of reference a mere notation; a diagonal one does not (T4)."""
    model, k = subject.model, subject.draw_place(draw)
    heard = rows_of(draw("stations heard", present_rows(len(model.stations), low=2)))
    first, *others = (_information(model.with_pairs(_against(heard, r)), k) for r in heard)
    ceiling = _ceiling(subject, k, heard)
    for r, other in zip(heard[1:], others, strict=True):
        agree(
            f"information against station {r}",
            other[0],
            f"that against station {heard[0]}",
            first[0],
            scale=np.max([ceiling, first[1], other[1]], axis=0),
            tolerance=1e-7,
        )


@law(
    "reference-free",
    "H' R^-1 H = U' W U - (U' W 1)(1' W U) / (1' W 1), with U the gradients per station and W^-1 "
    "the diagonal of sigma² and the stations' own errors",
    exempt=_unshared,
)
def reference_free(subject: Measured, draw: Draw) -> None:
    """Differences say what the arrivals say once their common offset is unknown."""
    model, k = subject.model, subject.draw_place(draw)
    heard = rows_of(draw("stations heard", present_rows(len(model.stations), low=2)))
    U, w = _per_station(subject, k, heard)
    one = U.T @ w
    expected = (U.T * w) @ U - np.outer(one, one) / w.sum()
    found, size = _information(model.with_pairs(_against(heard, heard[0])), k)
    agree(
        "H' R^-1 H",
        found,
        "the reference-free information",
        expected,
        scale=np.maximum(_ceiling(subject, k, heard), size),
        tolerance=1e-7,
    )


def _ceiling(subject: Measured, k: Kinematics, heard: Index) -> Array:
    """Magnitude (2d, 2d) of the information before the unknown offset takes its share."""
    U, w = _per_station(subject, k, heard)
    largest = np.sqrt(np.sum(w[:, None] * U * U, axis=0))
    return np.outer(largest, largest)


def _per_station(subject: Measured, k: Kinematics, heard: Index) -> tuple[Array, Array]:
    """Gradients (n, 2d) of range or range rate per station, and weights (n,), from scratch."""
    model, stations = subject.model, subject.model.stations
    s, vs = (part[heard] for part in stations.at(k.time))
    delta, w = k.position - s, k.velocity - vs
    r = np.linalg.norm(delta, axis=-1, keepdims=True)
    u = delta / r
    ranging = getattr(model, "toa_sigma", None) is not None
    b = (w - np.sum(u * w, axis=-1, keepdims=True) * u) / r
    U = np.hstack([u, np.zeros_like(u)]) if ranging else np.hstack([b, u])
    name = SHARED[0] if ranging else SHARED[1]
    sigma = np.asarray(getattr(model, name), dtype=float)
    if getattr(model, "sigma_times", None) is not None:
        sigma = sigma[int(np.flatnonzero(np.asarray(model.sigma_times) == k.time)[0])]
    scale = float(np.asarray(model.scale)[0])
    variance = (scale * np.broadcast_to(sigma, (len(stations),))[heard]) ** 2
    d = len(k.position)
    for part, C in (
        (U[:, :d], stations.position_covariance),
        (U[:, d:], stations.velocity_covariance),
    ):
        if C is not None:
            variance = variance + np.einsum("si,sij,sj->s", part, C[heard], part)
    return U, 1.0 / variance
