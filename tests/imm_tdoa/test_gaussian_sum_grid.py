"""Source C's Gaussian sum against the wrapped normal likelihood on a grid, 20 updates (§14.2).

With a component for every ambiguity integer the two must agree: each lobe of the likelihood has
a component of its own, about 20 m wide and 840 m deep at 100 km, over which phase and rate are
straight; what differs is their bending along the range and rounding of the grid. Six components
of every ninth integer cannot agree: after one wrapped innovation each has settled on one lobe of
the nine it stands for (§7.3). They keep within about half a sigma of the grid's mean.
"""

from __future__ import annotations

import numpy as np
import phase_grid as grid
import pytest

from imm_tdoa.reproduce.phase_difference import Scenario, Switches

DEG = np.pi / 180.0
RUNS = 3
FLIGHT = 10.0  # s, 20 updates
EVERY = Scenario(count=None, every=1, lobe_deg=None, merging=False, duration_s=FLIGHT)


@pytest.fixture(scope="module")
def oracle() -> tuple[np.ndarray, np.ndarray]:
    """Mean (runs, 21, 2) and covariance of the grid density after each scan."""
    z, bearing = EVERY.draw(3, RUNS)
    observer = grid.Observer(
        EVERY.measurement().electrical_length, 270.0, 10 * DEG, 0.5 * DEG, 10.0, 2.0
    )
    found = []
    for run in range(RUNS):
        x, y, log_p = grid.first(observer, *z[run, 0], bearing[run], 10 * DEG, coarse=61)
        for k, time in enumerate(EVERY.times):
            if k:
                log_p = grid.update(observer, x, y, log_p, *z[run, k], time)
            found.append(grid.moments(x, y, log_p))
    m, P = (np.array(a) for a in zip(*found, strict=True))
    return m.reshape(RUNS, -1, 2), P.reshape(RUNS, -1, 2, 2)


def tracked(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the Gaussian sum after each scan, the first included."""
    z, bearing = scenario.draw(3, RUNS)
    gs = scenario.tracker(Switches())
    start = gs.start(0.0, *scenario.begin(z[:, 0], bearing, Switches()))
    track = gs.run(scenario.times[1:], z[:, 1:], start)
    return (
        np.concatenate([start.mean[:, None], track.mean], axis=1),
        np.concatenate([start.covariance[:, None], track.covariance], axis=1),
    )


def compare(found, wanted):
    """Distance of means in the oracle's sigmas, and ratios of spread along its axes."""
    L = np.linalg.cholesky(wanted[1])
    off = np.linalg.solve(L, (found[0] - wanted[0])[..., None])[..., 0]
    W = np.linalg.solve(L, found[1])
    W = np.linalg.solve(L, np.swapaxes(W, -1, -2))
    return np.linalg.norm(off, axis=-1), np.sqrt(np.linalg.eigvalsh(W))


def test_a_component_for_every_integer_is_the_grid(oracle) -> None:
    """Means within 0.03 sigma, spreads within 3 %, at every one of 20 updates."""
    off, ratio = compare(tracked(EVERY), oracle)
    assert off[:, 0].max() < 1e-3
    assert off.max() < 0.03
    assert np.abs(ratio - 1.0).max() < 0.03


def test_six_components_stay_near_the_grid(oracle) -> None:
    """Means within 0.6 sigma; spreads from half the grid's to a third more."""
    off, ratio = compare(tracked(Scenario(duration_s=FLIGHT)), oracle)
    assert off.max() < 0.6
    assert ratio.min() > 0.45
    assert ratio.max() < 1.33


def test_the_oracle_knows_its_observer() -> None:
    """Its hand-written phase, rate and R are those of the measurement model."""
    model = EVERY.measurement()
    K = model.electrical_length
    observer = grid.Observer(K, 270.0, 10 * DEG, 0.5 * DEG, 10.0, 2.0)
    p, t = np.array([50e3, 70e3]), 6.0
    phase, rate, a, b, c = observer.look(*p, t)
    want = model.predict(p, np.zeros(2), t)
    assert np.allclose([(phase + np.pi) % (2 * np.pi) - np.pi, rate], want, rtol=1e-9)
    assert np.allclose([[a, b], [b, c]], model.noise_covariance(p, np.zeros(2), t), rtol=1e-9)
