"""The laws of single errors, and random streams by name."""

from __future__ import annotations

import numpy as np
import pytest
from simulate_cases import binomial_tolerance, covariance_tolerance

from imm_tdoa.simulate.errors import between, clock_offsets, gauss_markov, gross, heard
from imm_tdoa.simulate.faults import Clock, Dropouts, Silence
from imm_tdoa.simulate.streams import Streams

N = 40_000


def test_gauss_markov_has_an_exponential_autocovariance_over_any_steps() -> None:
    times = np.array([0.0, 0.5, 0.6, 3.0, 9.0, 9.0])
    unit = np.random.default_rng(1).standard_normal((len(times), N))
    x = gauss_markov(unit, times, 2.0, 4.0)
    expected = 4.0 * np.exp(-np.abs(times[:, None] - times) / 4.0)
    assert np.all(np.abs(x @ x.T / N - expected) < covariance_tolerance(expected, N))
    np.testing.assert_array_equal(x[4], x[5])


def test_between_two_values_the_process_keeps_its_law() -> None:
    rng = np.random.default_rng(2)
    times = np.array([0.0, 0.7, 1.5])
    ends = gauss_markov(rng.standard_normal((2, N)), times[[0, 2]], 1.0, 1.0)
    a, b = np.full((N, 1), 0.7), np.full((N, 1), 0.8)
    middle = between(rng.standard_normal((N, 1)), ends[0][:, None], ends[1][:, None], a, b)
    x = np.stack([ends[0], middle[:, 0], ends[1]])
    expected = np.exp(-np.abs(times[:, None] - times))
    assert np.all(np.abs(x @ x.T / N - expected) < covariance_tolerance(expected, N))
    zero, one = np.zeros((N, 1)), np.ones((N, 1))
    at_start = between(rng.standard_normal((N, 1)), ends[0][:, None], ends[1][:, None], zero, one)
    np.testing.assert_allclose(at_start[:, 0], ends[0], rtol=1e-14)


@pytest.mark.parametrize("late", [False, True])
def test_gross_errors_come_as_often_and_as_large_as_said(late: bool) -> None:
    error = gross(np.random.default_rng(3), N, 0.1, 2.0, late)
    hit = error != 0.0
    assert abs(hit.mean() - 0.1) < binomial_tolerance(0.1, N)
    size = np.abs(error[hit])
    assert size.min() >= 1.0
    assert size.max() <= 3.0
    # uniform within 1 to 3: mean 2, variance 1/3
    assert abs(size.mean() - 2.0) < 5.0 * np.sqrt(1.0 / 3.0 / hit.sum())
    share = (error[hit] > 0.0).mean()
    assert share == 1.0 if late else abs(share - 0.5) < binomial_tolerance(0.5, int(hit.sum()))
    assert not np.any(gross(np.random.default_rng(3), N, 0.0, 2.0, late))


def test_dropouts_of_scans_stations_and_silences() -> None:
    drop = Dropouts(
        scan=0.1,
        station={"b": 0.3, "c": 1.0},
        silences=[Silence(station="d", from_s=10.0, to_s=20.0), Silence(station="e", from_s=5e3)],
    )
    stations, times = ("a", "b", "c", "d", "e"), np.arange(20_000.0)
    mask = heard(drop, Streams.from_seed(4), "x", stations, times)
    n = len(times)
    assert abs((~mask[:, 0]).mean() - 0.1) < binomial_tolerance(0.1, n)
    b = mask[mask[:, 0], 1]
    assert abs((~b).mean() - 0.3) < binomial_tolerance(0.3, len(b))
    assert not mask[:, 2].any()
    assert not mask[~mask[:, 0]].any()
    np.testing.assert_array_equal(mask[:10, 3], mask[:10, 0])
    assert not mask[10:21, 3].any()
    np.testing.assert_array_equal(mask[21:, 3], mask[21:, 0])
    np.testing.assert_array_equal(mask[:5000, 4], mask[:5000, 0])
    assert not mask[5000:, 4].any()


def test_a_clock_is_offset_drift_and_spread() -> None:
    clock = Clock(
        offset_s=3.0,
        drift=1e-3,
        spread_s=0.2,
        range_rate_spread_mps=0.0,
        range_rate_offset_mps=7.0,
        range_rate_drift_mps2=-2.0,
    )
    elapsed = np.linspace(0.0, 100.0, N)
    time, rate = clock_offsets(clock, Streams.from_seed(5), "x", elapsed)
    rest = time - 3.0 - 1e-3 * elapsed
    assert np.abs(rest).max() <= 0.1
    # uniform over 0.2: variance 0.04 / 12, fourth moment 0.2^4 / 80
    spread = np.sqrt((0.2**4 / 80.0 - (0.04 / 12.0) ** 2) / N)
    assert abs(np.mean(rest**2) - 0.04 / 12.0) < 5.0 * spread
    np.testing.assert_allclose(rate, 7.0 - 2.0 * elapsed)


def test_streams_are_told_apart_by_name_and_seed() -> None:
    streams = Streams.from_seed(6)
    first = streams.of("arrival", "x", "a").standard_normal(100)
    np.testing.assert_array_equal(first, streams.of("arrival", "x", "a").standard_normal(100))
    others = [
        streams.of("arrival", "x", "b"),
        streams.of("arrival", "xa"),
        streams.of("arrival", "x"),
        streams.of("x", "arrival", "a"),
        Streams.from_seed(7).of("arrival", "x", "a"),
    ]
    for other in others:
        r = np.corrcoef(first, other.standard_normal(100))[0, 1]
        assert abs(r) < 0.5
    both = streams.columns(("arrival", "x"), ("b", "a"), 100)
    np.testing.assert_array_equal(both[:, 1], first)


def test_seeds_of_every_kind() -> None:
    def draw(streams: Streams) -> float:
        return float(streams.of("x").random())

    assert draw(Streams.from_seed(1)) == draw(Streams.from_seed(np.random.SeedSequence(1)))
    children = np.random.SeedSequence(1).spawn(2)
    assert len({draw(Streams.from_seed(child)) for child in children}) == 2
    one, two = np.random.default_rng(1), np.random.default_rng(1)
    assert draw(Streams.from_seed(one)) == draw(Streams.from_seed(two))
    assert draw(Streams.from_seed(one)) != draw(Streams.from_seed(np.random.default_rng(1)))
    for bad in (-1, 1.5, True, "1"):
        with pytest.raises(ValueError, match="seed: expected a whole number of at least 0"):
            Streams.from_seed(bad)  # type: ignore[arg-type]
