"""From scans and states to the arrays that the recursion takes, and back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
import scipy

from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.kernel.layout import Feed, Robust
from imm_tdoa.kernel.plan import Plan, makeup_of
from imm_tdoa.kernel.reading import LOST, REJECTED, SINCE, SNAPSHOT, USED
from imm_tdoa.reopening import Trust
from imm_tdoa.state import State, Taken

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM


def spread(array: Any, trailing: int, targets: int) -> Any:
    """Return (1 | B, 1 | T, ...) of an array whose last `trailing` axes are no batch axes."""
    batch = array.shape[: array.ndim - trailing]
    if len(batch) < 2:
        array = array.reshape((1,) * (2 - len(batch)) + array.shape)
    else:
        own = math.prod(batch[:-1])
        assert own in (1, targets)
        array = array.reshape(own, *array.shape[array.ndim - trailing - 1 :])
    return plain(array)


def plain(array: Any) -> Any:
    """Return a contiguous array that may be written to, the same one where it is such.

    To Numba any other kind is another type, for which it would compile the kernel anew.
    """
    result = np.ascontiguousarray(array)
    return result if result.flags.writeable else result.copy()


def untouchable(array: Any) -> Array:
    """Return a contiguous view that may not be written to; see `plain`. Large arrays stay as is."""
    result = np.ascontiguousarray(array, dtype=float)
    result = result.view() if result.flags.aligned else result.copy()
    result.setflags(write=False)
    return result


def feed(
    plan: Plan,
    measurement: MeasurementModel,
    times: Array,
    dt: Array,
    values: Array,
    since: Index,
    usable: Index | None,
) -> Feed:
    """Return what the recursion takes of B targets through T scans.

    Parameters
    ----------
    measurement : MeasurementModel
        Of all scans at once: its pairs may be (T, m, 2) or (B, T, m, 2).
    times, dt : (1 | B, T)
        Of the scans, and since the one before, s.
    values : (1 | B, T, m)
        What was measured.
    since : (1 | B,)
        First scan that each target takes in.
    usable : (1 | B, T, m), optional
        Rows that do not repeat others.
    """
    makeup = makeup_of(measurement)
    assert makeup is not None
    d, m, T = measurement.dims, measurement.size, times.shape[-1]
    B = max(len(times), len(values))
    tables, step = plan.tables(dt)
    still = np.zeros(d)
    clock = times[0] if len(times) == 1 else times
    noise = measurement.noise_covariance(still, still, noisy(times, values))
    where = [stations.at(clock) for stations in makeup.stations]
    place, speed = (
        _stacked([w[i] for w in where], d) if where else np.zeros((1, 1, 0, d)) for i in range(2)
    )
    pairs = np.stack([makeup.station, makeup.reference], axis=-2).astype(np.int64)
    pairs = spread(pairs, 2, B)
    if usable is None:
        usable = np.zeros((0, 0, m), dtype=np.int64)
    return Feed(
        tables=tables,
        step=plain(np.asarray(step, dtype=np.int64)).reshape(-1, T),
        values=untouchable(values),
        since=plain(np.asarray(since, dtype=np.int64)),
        usable=plain(np.asarray(usable, dtype=np.int64)),
        noise=spread(noise, 2, B),
        place=spread(place, 2, B),
        speed=spread(speed, 2, B),
        station=np.ascontiguousarray(pairs[..., 0, :, None]),
        reference=np.ascontiguousarray(pairs[..., 1, :, None]),
    )


def noisy(times: Array, values: Array) -> Array:
    """Times (T,) or (B, T) to ask the noise at: for a scan without rows another's, if there is one.

    At the time of such a scan no standard deviation need be known.
    """
    said = np.isfinite(values).any(axis=-1)
    if len(times) == 1:
        said = said.any(axis=0, keepdims=True)
    said = np.broadcast_to(said, times.shape)
    if not said.all() and said.any():
        first = times[np.arange(len(times)), np.argmax(said, axis=1)]
        first = np.where(said.any(axis=1), first, times[said][0])
        times = np.where(said, times, first[:, None])
    result: Array = times[0] if len(times) == 1 else times
    return result


def same_at_all_times(measurement: MeasurementModel) -> bool:
    """Whether stations stand still, noise is constant, and no row ever repeats others."""
    still = np.zeros(measurement.dims)
    try:
        noise = measurement.noise_covariance(still, still, np.zeros(2))
    except ValueError:  # standard deviations of certain times only
        return False
    parts = getattr(measurement, "models", (measurement,))
    moving = any(p.stations.moving for p in parts if hasattr(p, "stations"))
    fixed = all(p.pairs.ndim == 2 for p in parts if hasattr(p, "pairs"))
    every = np.ones(measurement.size, dtype=bool)
    return noise.ndim == 2 and fixed and not moving and bool(measurement.independent(every).all())


def template(plan: Plan) -> Feed | None:
    """Return what every feed of this plan's own measurement has; None where it depends on time."""
    measurement = plan.imm.measurement
    if "template" not in plan.kept:
        one, m = np.zeros((1, 1)), measurement.size
        none = np.full((1, 1, m), np.nan)
        plan.kept["template"] = (
            feed(plan, measurement, one, one, none, np.zeros(1, dtype=np.int64), None)
            if same_at_all_times(measurement)
            else None
        )
    known: Feed | None = plan.kept["template"]
    return known


def _stacked(parts: list[Array], d: int) -> Array:
    batch = np.broadcast_shapes(*(p.shape[:-2] for p in parts))
    return np.concatenate([np.broadcast_to(p, (*batch, *p.shape[-2:])) for p in parts], axis=-2)


def usable(measurement: MeasurementModel, times: Array, values: Array) -> Index | None:
    """Rows that do not merely repeat others; None where none ever does."""
    every = np.ones((*_pair_axes(measurement), measurement.size), dtype=bool)
    if measurement.independent(every).all():
        return None
    still = np.zeros(measurement.dims)
    heard = np.isfinite(measurement.predict(still, still, times[0] if len(times) == 1 else times))
    rows = measurement.independent(np.isfinite(values) & heard)
    result: Index = spread(rows.astype(np.int64), 1, len(rows))
    return result


def _pair_axes(measurement: MeasurementModel) -> tuple[int, ...]:
    """Leading axes of a measurement's pairs."""
    parts = getattr(measurement, "models", (measurement,))
    shapes = [p.pairs.shape[:-2] for p in parts if hasattr(p, "pairs")]
    return np.broadcast_shapes(*shapes) if shapes else ()


def robust(
    imm: IMM, measurement: MeasurementModel, times: Array, values: Array, trust: Array
) -> Robust | None:
    """Return how the recursion is to treat gross errors; None where it is not."""
    if imm.robust is None:
        return None
    still = np.zeros(measurement.dims)
    D, variance = measurement.error_sources(still, still, noisy(times, values))
    a, a0 = 0.5 * (imm.degrees_of_freedom + 1.0), 0.5 * imm.degrees_of_freedom
    constant = (
        (a - a0) * scipy.special.digamma(a) - scipy.special.gammaln(a) + scipy.special.gammaln(a0)
    )
    B = max(len(times), len(trust))
    return Robust(
        gates=imm.robust == "gate",
        threshold=float(scipy.special.chdtri(1.0, 1.0 - imm.gate_probability)),
        degrees_of_freedom=float(imm.degrees_of_freedom),
        constant=float(constant),
        digamma=float(scipy.special.digamma(a)),
        patience=imm.reopen_after,
        time=plain(np.asarray(times, dtype=float)),
        directions=spread(np.asarray(D, dtype=float), 2, B),
        variance=spread(np.asarray(variance, dtype=float), 1, B),
        trust=trust,
    )


def records(
    plan: Plan, state: State, batch: tuple[int, ...], out: Array, anew: bool = False
) -> None:
    """Fill `out` (B, size) with the states of targets with batch axes `batch`.

    `anew`: as if no scan had been taken in yet.
    """
    at = plan.record
    whole = out.reshape(*batch, at.size)
    means, squares = plan.sizes
    for j, (x, P) in enumerate(zip(state.means, state.covariances, strict=True)):
        whole[..., means[j] : means[j + 1]] = x
        whole[..., squares[j] : squares[j + 1]] = P.reshape(*P.shape[:-2], -1)
    whole[..., at.log_p : at.log_likelihood] = state.log_mode_probability
    whole[..., at.log_likelihood] = state.log_likelihood
    if anew:
        whole[..., at.nis :] = plan.nothing_taken
        return
    taken = state.taken
    whole[..., at.nis] = taken.nis
    whole[..., at.dof] = taken.nis_dof
    whole[..., at.mode_log_likelihood : at.mode_nis] = taken.mode_log_likelihood
    whole[..., at.mode_nis : at.row_weight] = taken.mode_nis
    whole[..., at.row_weight : at.lost] = taken.row_weight
    whole[..., at.lost] = state.trust.lost
    whole[..., at.reopened] = taken.reopened


def trusts(plan: Plan, state: State, batch: tuple[int, ...]) -> Array:
    """Return the trust records (B, ...) of targets with batch axes `batch`."""
    trust, squares = state.trust, plan.sizes[1]
    size, r = squares[-1], len(state.modes)
    whole = np.empty((*batch, SNAPSHOT + size + r))
    whole[..., REJECTED], whole[..., USED] = trust.rejected, trust.used
    whole[..., LOST], whole[..., SINCE] = trust.lost, trust.since
    means = plan.sizes[0]
    for j, (x, P) in enumerate(zip(trust.means, trust.covariances, strict=True)):
        whole[..., SNAPSHOT + means[j] : SNAPSHOT + means[j + 1]] = x
        flat = P.reshape(*P.shape[:-2], -1)
        whole[..., SNAPSHOT + squares[j] : SNAPSHOT + squares[j + 1]] = flat
    whole[..., SNAPSHOT + size :] = trust.log_mode_probability
    return whole.reshape(-1, whole.shape[-1])


def modes(plan: Plan, whole: Array, offset: int = 0) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Return views of the modes' means (..., n) and covariances (..., n, n) in records."""
    means, squares = plan.sizes
    xs, Ps = [], []
    for j in range(len(means) - 1):
        k = means[j + 1] - means[j]
        xs.append(whole[..., offset + means[j] : offset + means[j + 1]])
        P = whole[..., offset + squares[j] : offset + squares[j + 1]]
        Ps.append(P.reshape(*whole.shape[:-1], k, k))
    return tuple(xs), tuple(Ps)


def taken(plan: Plan, whole: Array) -> Taken:
    """Return what records (..., size) say of the last scan."""
    at = plan.record
    return Taken(
        nis=whole[..., at.nis],
        nis_dof=whole[..., at.dof].astype(np.int64),
        mode_log_likelihood=whole[..., at.mode_log_likelihood : at.mode_nis],
        mode_nis=whole[..., at.mode_nis : at.row_weight],
        row_weight=whole[..., at.row_weight : at.lost],
        reopened=flag(plan, whole, at.reopened),
    )


def flag(plan: Plan, whole: Array, number: int) -> Any:
    """Whether a number of the records is set, of those that only a robust filter ever sets."""
    if plan.imm.robust is None:  # looking would fetch all records from memory once more
        return np.zeros(whole.shape[:-1], dtype=bool)
    return whole[..., number] > 0.0


def state_of(plan: Plan, like: State, time: Array, whole: Array, trust: Array | None) -> State:
    """Return the states that records (..., size) hold; `trust` (..., width) where it is kept."""
    at = plan.record
    means, covariances = modes(plan, whole)
    result = attrs.evolve(
        like,
        time=time,
        means=means,
        covariances=covariances,
        log_mode_probability=whole[..., at.log_p : at.log_likelihood],
        log_likelihood=whole[..., at.log_likelihood],
        taken=taken(plan, whole),
    )
    if trust is None:
        return result
    xs, Ps = modes(plan, trust, SNAPSHOT)
    return attrs.evolve(
        result,
        trust=Trust(
            rejected=trust[..., REJECTED].astype(np.int64),
            used=trust[..., USED].astype(np.int64),
            lost=trust[..., LOST] > 0.0,
            since=trust[..., SINCE],
            means=xs,
            covariances=Ps,
            log_mode_probability=trust[..., SNAPSHOT + plan.sizes[1][-1] :],
        ),
    )
