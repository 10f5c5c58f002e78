"""Banks, measurements and scans on which both engines are tried, and how they are compared."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from imm_tdoa import IMM, Bank, Stations, Track
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Height,
    Position,
    RangeRate,
    Singer,
    Stack,
    Static,
)

TOLERANCE = 1e-9
SPEED = 299_792_458.0
TIMES = np.cumsum([0.5, 1.0, 0.25, 2.0, 0.0, 1.0, 1.0, 3.0, 0.5, 1.0])  # one scan twice at a time


class Case(NamedTuple):
    """A run: its IMM, scans and start."""

    imm: IMM
    times: Any
    values: Any
    start: Any = None
    pairs: Any = None

    def run(self, engine: str, **more: Any) -> Track:
        """Return the track by one of the engines."""
        return self.imm.run(
            self.times, self.values, start=self.start, pairs=self.pairs, engine=engine, **more
        )


# --- comparing ---------------------------------------------------------------------------------


def assert_alike(got: Any, want: Any, tolerance: float = TOLERANCE) -> None:
    """Assert that two tracks (or two states) are the same numbers.

    States to `tolerance` of their own standard deviation and size, covariances of the product of
    standard deviations. Log-likelihoods to `tolerance` of their size, and of 1. The logs of mode
    probabilities are what is left when such log-likelihoods are subtracted from each other, so
    they, and with them the moments of all modes together, are held to the size of the largest.
    """
    time = len(want.log_likelihood.shape) if isinstance(want, Track) else None
    said = want if time is not None else want.taken
    seen = got if time is not None else got.taken
    states = (
        (want.mode_means, want.mode_covariances, got.mode_means, got.mode_covariances)
        if time is not None
        else (want.means, want.covariances, got.means, got.covariances)
    )
    for x, P, own_x, own_P in zip(*states, strict=True):
        _assert_gaussians(own_x, own_P, x, P, tolerance)
    size = 1.0 + _largest(said.mode_log_likelihood)
    _assert_gaussians(got.mean, got.covariance, want.mean, want.covariance, tolerance * size)
    logs = {
        name: (getattr(a, name), getattr(b, name), floor)
        for a, b, name, floor in (
            (got, want, "log_mode_probability", size),
            (got, want, "log_likelihood", size),
            (seen, said, "mode_log_likelihood", 1.0),
            (seen, said, "nis", 1.0),
            (seen, said, "mode_nis", 1.0),
            (seen, said, "row_weight", 1.0),
        )
    }
    for name, (a, b, floor) in logs.items():
        assert a.shape == b.shape, name
        _assert_within(name, a, b, tolerance * (floor + np.abs(np.where(np.isfinite(b), b, 0.0))))
    np.testing.assert_array_equal(seen.nis_dof, said.nis_dof)
    assert seen.nis_dof.dtype == said.nis_dof.dtype
    np.testing.assert_array_equal(seen.reopened, said.reopened)
    lost = (got.lost, want.lost) if time is not None else (got.trust.lost, want.trust.lost)
    np.testing.assert_array_equal(*lost)


def _assert_gaussians(x: Any, P: Any, want_x: Any, want_P: Any, tolerance: float) -> None:
    assert x.shape == want_x.shape
    assert P.shape == want_P.shape
    sd = np.sqrt(np.einsum("...ii->...i", np.where(np.isnan(want_P), 0.0, want_P)).clip(0.0))
    size = np.where(np.isnan(want_x), 0.0, np.abs(want_x))
    _assert_within("mean", x, want_x, tolerance * (sd + size) + 1e-300)
    _assert_within("covariance", P, want_P, tolerance * sd[..., :, None] * sd[..., None, :] + 1e-24)


def _assert_within(name: str, a: Any, b: Any, allowed: Any) -> None:
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        away = np.where(same, 0.0, np.abs(a - b))
    assert not np.any(np.isnan(away)), f"{name}: NaN or infinite in one engine only"
    ratio = np.max(away / allowed, initial=0.0)
    assert ratio <= 1.0, f"{name}: off by {ratio:.3g} times what is allowed"


def _largest(a: Any) -> float:
    return float(np.max(np.abs(a[np.isfinite(a)]), initial=0.0))


def assert_engines_agree(case: Case, tolerance: float = TOLERANCE, **more: Any) -> Track | None:
    """Assert that both engines give the same track, or the same error; return NumPy's."""
    try:
        want = case.run("numpy", **more)
    except ValueError as error:
        message = str(error)
    else:
        got = case.run("compiled", **more)
        assert (want.engine, got.engine) == ("numpy", "compiled")
        np.testing.assert_array_equal(got.times, want.times)
        assert got.keep == want.keep
        assert_alike(got, want, tolerance)
        return want
    with pytest.raises(ValueError, match=re.escape(message)):
        case.run("compiled", **more)
    return None


# --- drawing -----------------------------------------------------------------------------------

LEVELS = st.sampled_from([0.0, 0.01, 1.0, 30.0])


@st.composite
def motions(draw: st.DrawFn) -> Any:
    """One linear motion model, continuous or piecewise."""
    noise = {draw(st.sampled_from(["psd", "std"])): draw(LEVELS)}
    model = draw(st.sampled_from([Static, ConstantVelocity, ConstantAcceleration, Singer]))
    if model is Singer:
        return Singer(**noise, time_constant=draw(st.sampled_from([0.8, 20.0])))
    return model(**noise)


@st.composite
def banks(draw: st.DrawFn, high: int = 4) -> Bank:
    """One to four modes, any chain, prior and mixing rule."""
    models = draw(st.lists(motions(), min_size=1, max_size=high))
    r = len(models)
    weights = st.lists(st.sampled_from([0, 0, 1, 1, 3, 40]), min_size=r, max_size=r)
    row = weights.filter(any).map(lambda w: np.array(w) / np.sum(w))
    chain: dict[str, Any] = draw(
        st.one_of(
            st.just({}),
            st.sampled_from([1e-3, 5.0, np.inf]).map(lambda s: {"mean_sojourn": s}),
            st.lists(st.sampled_from([0.5, 60.0]), min_size=r, max_size=r).map(
                lambda s: {"mean_sojourn": s}
            ),
            st.just({"transition": np.eye(r)}),
            st.lists(row, min_size=r, max_size=r).map(lambda w: {"transition": np.stack(w)}),
        )
    )
    return Bank(
        models,
        **chain,
        prior=draw(st.one_of(st.none(), row)),
        mixing=draw(st.sampled_from(["birth", "unbiased", "zero"])),
        birth_std=draw(st.sampled_from([{}, {"velocity": 30.0, "acceleration": 30.0}])),
        names=[f"mode {j}" for j in range(r)],
    )


def station_array(dims: int, rng: np.random.Generator, *, count: int, moving: bool) -> Stations:
    """Stations around the origin, some kilometres out; moving ones are unheard now and then."""
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.5, count)) / count
    places = np.zeros((count, dims))
    places[:, 0] = 9e3 * np.cos(angle) + rng.uniform(-500.0, 500.0, count)
    if dims > 1:
        places[:, 1] = 9e3 * np.sin(angle)
    if dims > 2:
        places[:, 2] = rng.uniform(0.0, 3e3, count)
    velocity = rng.uniform(-30.0, 30.0, places.shape)
    if not moving:
        return Stations(places, velocities=velocity)
    times = np.concatenate([[-1.0], TIMES[np.diff(TIMES, prepend=-9.0) > 0.0]])
    path = places + times[:, None, None] * velocity
    gone = rng.random((len(times), count)) < 0.1
    path[gone] = np.nan
    return Stations(path, times=times)


@st.composite
def measurements(draw: st.DrawFn, dims: int, rng: np.random.Generator) -> Any:
    """One measurement model, or a stack of several."""
    count = draw(st.integers(3, 5))
    stations = station_array(dims, rng, count=count, moving=draw(st.booleans()))
    sampled = draw(st.sampled_from([False, False, True]))
    stamps = np.unique(TIMES)

    def sigma(level: float, rows: int) -> dict[str, Any]:
        if sampled:
            return {"sigma": level * rng.uniform(0.5, 2.0, (len(stamps), rows)), "times": stamps}
        value = draw(st.sampled_from([level, level * rng.uniform(0.5, 2.0, rows)]))
        return {"sigma": value, "times": None}

    def differences(kind: Any, shared: str, own: str, level: float) -> Any:
        pairs = draw(
            st.one_of(
                st.sampled_from(["reference", "adjacent"]),
                st.permutations([[i, j] for i in range(count) for j in range(i)]).map(
                    lambda p: np.array(p[: 1 + int(rng.integers(count + 1))])
                ),
            )
        )
        name = draw(st.sampled_from([shared, own]))
        rows = count if name == shared else len(kind(stations, pairs=pairs, **{own: 1.0}).pairs)
        how = sigma(level, rows)
        return kind(stations, pairs=pairs, **{name: how["sigma"]}, sigma_times=how["times"])

    def one(kind: str) -> Any:
        if kind == "tdoa":
            return differences(TDOA, "toa_sigma", "tdoa_sigma", 3.0 / SPEED)
        if kind == "fdoa":
            return differences(FDOA, "range_rate_sigma", "difference_sigma", 0.5)
        if kind == "toa":
            how = sigma(3.0 / SPEED, count)
            return TOA(stations, sigma=how["sigma"], sigma_times=how["times"])
        if kind == "range rate":
            how = sigma(0.5, count)
            return RangeRate(stations, sigma=how["sigma"], sigma_times=how["times"])
        if kind == "height":
            how = sigma(20.0, 1)
            if not sampled:
                how["sigma"] = 20.0
            frame = draw(st.sampled_from([None, EastNorthUp(48.0, 11.0, 500.0)]))
            return Height(how["sigma"], frame=frame, sigma_times=how["times"])
        how = sigma(10.0, dims)
        return Position(how["sigma"], dims=dims, sigma_times=how["times"])

    if dims == 1:
        return one("position")
    kinds = ["tdoa", "tdoa", "toa", "fdoa", "range rate", "position"] + ["height"] * (dims == 3)
    chosen = draw(st.lists(st.sampled_from(kinds), min_size=1, max_size=3, unique=True))
    models = [one(kind) for kind in chosen]
    return models[0] if len(models) == 1 else Stack(*models)


class Batch(NamedTuple):
    """Leading axes of what a run is given."""

    values: tuple[int, ...]
    start: tuple[int, ...]
    times: tuple[int, ...]


BATCHES = (
    Batch((), (), ()),
    Batch((1,), (), ()),
    Batch((2,), (2,), ()),
    Batch((3,), (3,), (3,)),
    Batch((), (5,), ()),
    Batch((2, 3), (2, 1), (1, 3)),
    Batch((9,), (), ()),
    Batch((3, 6), (3, 6), ()),
    Batch((19,), (19,), (19,)),
)
FEW = tuple(Batch(axes, axes, ()) for axes in ((), (1,), (3,), (2, 4)))
NOT_FOUR = tuple(  # those that are not computed four by four
    b for b in BATCHES if not 3 <= np.prod(np.broadcast_shapes(*b)) <= 8
)


@st.composite
def cases(
    draw: st.DrawFn, rule: str | None = None, batches: tuple[Batch, ...] | None = None
) -> Case:
    """A bank on a measurement and some scans of a batch of targets, most of them plausible."""
    if batches is None:
        batches = BATCHES if rule is None else NOT_FOUR
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dims = draw(st.sampled_from([1, 2, 2, 3]))
    measurement = draw(measurements(dims, rng))
    imm = IMM(
        draw(banks()),
        measurement,
        merging=draw(st.sampled_from(["imm", "imm", "autonomous"])),
        robust=rule,  # type: ignore[arg-type]
        reopen_after=2,
    )
    batch = draw(st.sampled_from(batches))
    T = draw(st.integers(1, len(TIMES)))
    times = np.broadcast_to(TIMES[:T], (*batch.times, T)).copy()
    if batch.times:  # each target hears some of the scans at times of its own
        skip = rng.integers(0, len(TIMES) - T + 1, batch.times)
        times = TIMES[skip[..., None] + np.arange(T)]
    whole = np.broadcast_shapes(batch.values, batch.start, batch.times)
    place, velocity = _courses(rng, batch, whole, dims, times)
    clean = measurement.predict(place, velocity, times)
    R = measurement.noise_covariance(place, velocity, times)
    sigma = np.sqrt(np.einsum("...ii->...i", R))
    values = (clean + sigma * rng.normal(size=clean.shape)) / measurement.scale
    values = _for_batch(values, batch.values, 2)
    missing = draw(st.sampled_from([0.0, 0.3, 0.9]))
    values[rng.random(values.shape) < missing] = np.nan
    values[rng.random(values.shape[:-1]) < 0.2 * missing] = np.nan
    if batch.values and missing:
        values[rng.random(batch.values) < 0.2] = np.nan
    if rule:
        gross = rng.random(values.shape) < draw(st.sampled_from([0.0, 0.1, 0.5]))
        by = draw(st.sampled_from([8.0, 100.0, 1e4]))
        typical = np.nanmean(sigma.reshape(-1, measurement.size), axis=0) / measurement.scale
        values = values + np.where(gross, by * typical * rng.choice([-1.0, 1.0], values.shape), 0.0)
    before = -draw(st.sampled_from([0.0, 0.5])) + float(times.min()) * draw(st.sampled_from([0, 1]))
    first = _for_batch(place[..., 0, :], batch.start, 1)
    start = imm.start(before, first + rng.normal(0.0, 30.0, first.shape), 900.0 * np.eye(dims))
    return Case(imm, times, values, start)


def _courses(
    rng: np.random.Generator, batch: Batch, whole: tuple[int, ...], dims: int, times: Any
) -> tuple[Any, Any]:
    """Straight courses (..., T, d); targets that share a start or values are close together."""
    axes = range(-len(whole), 0)
    own = tuple(
        whole[a] if all(len(b) >= -a and b[a] == whole[a] for b in batch[:2]) else 1 for a in axes
    )
    position = rng.uniform(-4e3, 4e3, (*own, 1, dims)) + rng.normal(0.0, 10.0, (*whole, 1, dims))
    velocity = rng.uniform(-40.0, 40.0, (*own, 1, dims))
    place = position + velocity * (times - TIMES[0])[..., None]
    return place, np.broadcast_to(velocity, place.shape)


def _for_batch(array: Any, batch: tuple[int, ...], trailing: int) -> Any:
    """The first of each of `array`'s leading axes that is longer than in `batch`."""
    lead = array.shape[: array.ndim - trailing]
    array = array[(0,) * (len(lead) - len(batch))]
    index = tuple(slice(0, n) for n in batch)
    return np.array(array[index])
