"""Source A's estimators: the library's where they are right, as wrong as measured where not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.motion_form import faithful, scenario, tracking
from imm_tdoa.reproduce.motion_form.scenario import CONSTANT_ACCELERATION, CONSTANT_VELOCITY, STATIC
from imm_tdoa.reproduce.motion_form.switches import Switches
from imm_tdoa.reproduce.motion_form.table_one import table
from imm_tdoa.reproduce.motion_form.tracking import Data

C = 299_792_458.0


@pytest.mark.parametrize("model", scenario.MODELS)
@pytest.mark.parametrize("noise", ["independent", "correlated"])
def test_with_everything_right_it_is_the_librarys_filter(model: str, noise: str) -> None:
    switches = Switches(noise=noise)  # type: ignore[arg-type]
    data = Data.drawn(4, 3, CONSTANT_ACCELERATION, switches)
    theirs = tracking.model_positions(model, data, 1e-4)
    ours = faithful.extended_kalman(
        scenario.measurement(switches),
        scenario.motion_model(model, 1e-4),
        data.motion.times,
        data.values,
        *tracking.first_state(data.first.position, data.first.covariance, model),
    )
    assert_allclose(ours, theirs, rtol=0, atol=1e-5)  # m, of some 500 km


def test_the_printed_jacobian_is_that_of_the_state_before() -> None:
    """(29) is the Jacobian at X(k+1) times the transition: finite differences one step back."""
    measurement, dt = scenario.measurement(Switches()), 2.0
    model = scenario.motion_model("constant-acceleration")
    x = np.array([300e3, 400e3, 900.0, -400.0, 80.0, 30.0])

    def measured(state: Array) -> Array:
        p = model.propagate(state, dt)[:2]
        return measurement.predict(p, np.zeros(2), 0.0)

    steps = np.diag([1.0, 1.0, 0.1, 0.1, 0.01, 0.01])
    slopes = [(measured(x + h) - measured(x - h)) / (2.0 * h.sum()) for h in steps]
    printed = faithful.jacobian(measurement, model.propagate(x, dt), dt, 0.0, "dt-scaled")
    assert_allclose(printed, np.stack(slopes, axis=-1), rtol=1e-5, atol=1e-9)
    right = faithful.jacobian(measurement, model.propagate(x, dt), dt, 0.0, "zeros")
    assert_allclose(right[:, :2], printed[:, :2])
    assert np.all(right[:, 2:] == 0.0)


def test_the_printed_jacobian_costs_what_was_measured() -> None:
    """§5.2-9: CV 0.604 -> 0.772 km, CA 0.761 -> 3.916 km, by a program that has an error too."""
    found = table(40, 1, Switches(jacobian="dt-scaled"))
    for name, printed in (("scenario-1", 0.772), ("scenario-3", 3.916)):
        row = found.row(name)
        assert row.sample is not None
        assert row.predicted_km is not None
        error = row.sample.standard_error_km
        assert abs(row.sample.mean_km - printed) < 3.0 * np.sqrt(2.0) * error
        assert abs(row.sample.mean_km - row.predicted_km.mean()) < 4.0 * error
        assert row.bound_km is None


def as_printed(tau: Array, guess: Array, steps: int) -> list[Array]:
    """Equations (3), (5), (8), (9) word for word, one target; s and m."""
    s = np.array([[0, 0], [1e5, 0], [-5e4, 86602.54037844388], [-5e4, -86602.54037844384]])
    X, path = guess, [guess]
    for _ in range(steps):
        r = np.linalg.norm(X - s, axis=1)
        H = np.array([(X - s[i]) / (C * r[i]) - (X - s[0]) / (C * r[0]) for i in (1, 2, 3)])
        tau_hat = (r[0] - r[1:]) / C
        X = X + np.linalg.inv(H.T @ H) @ H.T @ (tau - tau_hat)
        path.append(X)
    return path


def test_the_printed_sign_doubles_the_error_every_iteration() -> None:
    """§5.2-1: data and prediction follow (8), the Jacobian (3)."""
    truth = STATIC.truth()[:, 0, :2]
    values = scenario.ideal(STATIC)[:, 0]
    guess = truth + np.array([30.0, -10.0])
    places = faithful.iterates(scenario.measurement(Switches()), values, guess, 5, sign=-1.0)
    for p in range(3):
        assert_allclose(places[p], as_printed(-values[p], guess[p], 5), rtol=0, atol=1e-3)
    error = np.linalg.norm(places - truth[:, None], axis=-1)
    assert_allclose(error[:, 1:] / error[:, :-1], 2.0, rtol=5e-3)
    right = faithful.iterates(scenario.measurement(Switches()), values, guess, 5)
    assert_allclose(right[:, -1], truth, rtol=0, atol=1e-3)


def test_the_table_says_that_the_printed_sign_diverges() -> None:
    found = table(2, 1, Switches(tdoa_sign="eq8"))
    assert found.row("static-per-epoch").sample is None
    assert found.iterates_km is not None
    assert_allclose(found.iterates_km, 2.0 ** np.arange(7), rtol=0.1)
    recursive, right = found.row("static-recursive"), table(2, 1)
    assert recursive.sample is not None
    # Every update multiplies the error by about 1 + 1/(k + 1): by (20 + 2) / 2 in the end.
    first = 0.99
    assert 4.0 * first < recursive.sample.last_km < 30.0 * first
    for name in ("scenario-1", "scenario-2", "scenario-3"):  # (21) and (29) agree
        mine, theirs = found.row(name).sample, right.row(name).sample
        assert mine is not None
        assert theirs is not None
        assert mine.mean_km == theirs.mean_km


def test_no_process_noise_as_printed_is_what_ruins_scenario_2() -> None:
    """§5.2-8: with any process noise the mismatched filter stays near."""
    found = table(10, 1, Switches(process_noise=1e-3)).row("scenario-2").sample
    assert found is not None
    assert found.mean_km < 2.5


def test_motions_and_noise_are_what_they_say() -> None:
    truth = CONSTANT_VELOCITY.truth()
    assert_allclose(truth[:, 0, :2], [[300e3, 400e3], [350e3, 450e3], [250e3, 350e3]])
    assert_allclose(truth[:, -1, :2] - truth[:, 0, :2], [[0, 40e3], [0, -40e3], [0, 40e3]])
    curved = CONSTANT_ACCELERATION.truth()
    assert_allclose((curved - truth)[:, -1, 0], [-80e3, 80e3, 80e3])
    switching = scenario.SWITCHING
    assert switching.modes() == (
        ("static",) * 16 + ("constant-velocity",) * 15 + ("constant-acceleration",) * 15
    )
    path = switching.truth()
    assert_allclose(path[:, 15, :2], path[:, 0, :2])
    assert_allclose(path[:, 45, 0] - path[:, 0, 0], [-45e3, 45e3, 45e3])
    assert_allclose(path[:, 45, 1] - path[:, 0, 1], [60e3, -60e3, 60e3])
    few, many = (scenario.draw(7, runs, STATIC, Switches()) for runs in (2, 400))
    assert_allclose(few, many[:2])
    errors = (many - scenario.ideal(STATIC)) * 1e9
    assert_allclose(np.cov(errors.reshape(-1, 3).T), 1e4 * np.eye(3), atol=300.0)
    shared = scenario.draw(7, 400, STATIC, Switches(noise="correlated"))
    errors = (shared - scenario.ideal(STATIC)) * 1e9
    assert_allclose(np.cov(errors.reshape(-1, 3).T), 5e3 * (np.eye(3) + 1.0), atol=300.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tdoa_sign": "eq11"}, "tdoa_sign: expected one of slave-master, eq8, got 'eq11'"),
        ({"jacobian": "none"}, "jacobian: expected one of zeros, dt-scaled, got 'none'"),
        ({"process_noise": -1.0}, "process_noise: expected a number of at least 0, got -1.0"),
        ({"mixing": "zeros"}, "mixing: expected one of birth, unbiased, zero, got 'zeros'"),
    ],
)
def test_switches_refuse_what_they_do_not_know(given: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Switches(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize("runs", [1, 0, 2.0, True])
def test_a_standard_error_takes_two_runs(runs: int) -> None:
    with pytest.raises(ValueError, match="runs: expected a whole number of at least 2, got"):
        table(runs)
