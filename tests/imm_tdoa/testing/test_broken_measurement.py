"""Measurement models with one fault each: the law that should catch it does."""

from __future__ import annotations

import attrs
import numpy as np
import pytest

from imm_tdoa import Stations
from imm_tdoa.contract import Measurement
from imm_tdoa.models import FDOA, TDOA, TOA, Position
from imm_tdoa.testing import broken_laws, check_measurement_model
from imm_tdoa.testing.strategies import Kinematics, kinematics

STATIONS = Stations([[0.0, 0.0], [9e3, 1e3], [2e3, 8e3], [-7e3, -5e3]])
LOOP = [[1, 0], [2, 1], [0, 2]]


class JacobianSign(TDOA):
    def jacobian(self, position, velocity, time):
        Hp, Hv = super().jacobian(position, velocity, time)
        return -Hp, Hv


class DtColumns(TDOA):
    """Position gradients times the time step in the velocity columns: Source A (29)."""

    def jacobian(self, position, velocity, time):
        Hp, _ = super().jacobian(position, velocity, time)
        return Hp, 2.0 * Hp


class DiagonalNoise(TDOA):
    def sensor_covariance(self, time):
        R = super().sensor_covariance(time)
        return R * np.eye(self.size)


class WrongSharedNoise(TDOA):
    """Half the shared variance, as if the reference were better than it is."""

    def sensor_covariance(self, time):
        R = super().sensor_covariance(time)
        return R - 0.5 * (R - R * np.eye(self.size))


class AsymmetricNoise(TDOA):
    def noise_covariance(self, position, velocity, time):
        R = np.array(super().noise_covariance(position, velocity, time))
        R[..., 0, 1] *= 1.01
        return R


class NegativeNoise(TDOA):
    def noise_covariance(self, position, velocity, time):
        return -super().noise_covariance(position, velocity, time)


class SourcesTooLarge(TDOA):
    def error_sources(self, position, velocity, time):
        D, v = super().error_sources(position, velocity, time)
        return D, 2.0 * v


class NoSource(TDOA):
    """Nothing can go wrong with the last row."""

    def error_sources(self, position, velocity, time):
        D, v = super().error_sources(position, velocity, time)
        return D * (np.arange(len(D)) < len(D) - 1)[:, None], v


class KeepsLoops(TDOA):
    def independent(self, present):
        return present


class DropsTooMuch(TDOA):
    def independent(self, present):
        kept = np.array(super().independent(present))
        kept[..., -1] = False
        return kept


class InventsRows(TDOA):
    def independent(self, present):
        return np.ones_like(present)


class Anchored(TOA):
    """Measures from the origin as well."""

    def predict(self, position, velocity, time):
        far = np.linalg.norm(position, axis=-1, keepdims=True)
        return super().predict(position, velocity, time) + 0.01 * far

    def jacobian(self, position, velocity, time):
        Hp, Hv = super().jacobian(position, velocity, time)
        far = np.linalg.norm(position, axis=-1, keepdims=True)
        return Hp + 0.01 * (position / far)[..., None, :], Hv


class NorthCounts(TOA):
    """Adds a little of the northing of the line of sight: one direction is special."""

    def _off(self, position, time):
        return position[..., None, :] - self.stations.at(time)[0]

    def predict(self, position, velocity, time):
        off = self._off(position, time)
        return super().predict(position, velocity, time) + 0.01 * off[..., 1]

    def jacobian(self, position, velocity, time):
        Hp, Hv = super().jacobian(position, velocity, time)
        return Hp + 0.01 * np.array([0.0, 1.0]), Hv


class FixedScale(TDOA):
    """The speed of light wired in where the speed given belongs."""

    @property
    def scale(self):
        return np.full(self.size, 299792458.0)


class NoiseInSeconds(TDOA):
    def sensor_covariance(self, time):
        return super().sensor_covariance(time) / self.speed**2


class PairsInOrder(TDOA):
    """Sorts the pairs it is given."""

    def with_pairs(self, pairs):
        pairs = np.asarray(pairs)
        return super().with_pairs(np.sort(pairs, axis=-1))


class OneAtATime(TOA):
    def predict(self, position, velocity, time):
        place = self.stations.at(float(np.max(time)))[0]
        return np.linalg.norm(place - np.mean(np.atleast_2d(position), axis=0), axis=-1)


class InPlace(TOA):
    def predict(self, position, velocity, time):
        velocity += 1.0
        return super().predict(position, velocity, time)


class WrongShape(TOA):
    def predict(self, position, velocity, time):
        return super().predict(position, velocity, time)[..., :-1]


class IntegerAngles(TOA):
    @property
    def angular(self):
        return np.zeros(self.size)


class NoOffset(Measurement):
    """No size, no noise."""

    dims = 2

    def predict(self, position, velocity, time):
        return position


def tdoa(cls, **settings):
    return cls(STATIONS, **({"toa_sigma": 1e-7} | settings))


CASES = [
    (tdoa(JacobianSign), {"position jacobian"}),
    (tdoa(DtColumns, toa_sigma=None, tdoa_sigma=1e-7), {"velocity jacobian"}),
    (tdoa(DtColumns), {"velocity jacobian", "reference-free"}),
    (tdoa(DiagonalNoise), {"reference", "reference-free"}),
    (tdoa(WrongSharedNoise), {"reference", "reference-free"}),
    (tdoa(AsymmetricNoise, toa_sigma=None, tdoa_sigma=1e-7), set()),  # 1.01 times zero is zero
    (
        tdoa(NegativeNoise, toa_sigma=None, tdoa_sigma=1e-7),
        {"noise covariance", "noise definite", "error sources"},
    ),
    (tdoa(SourcesTooLarge), {"error sources"}),
    (tdoa(NoSource), {"error sources"}),
    (tdoa(KeepsLoops, pairs=LOOP), {"noise definite"}),
    (tdoa(DropsTooMuch), {"independent rows"}),
    (Anchored(STATIONS, sigma=1e-7), {"translation"}),
    (NorthCounts(STATIONS, sigma=1e-7), {"rotation"}),
    (tdoa(FixedScale), {"units"}),
    (tdoa(NoiseInSeconds, toa_sigma=None, tdoa_sigma=1e-7), {"units"}),
    (tdoa(NoiseInSeconds), {"units", "reference-free", "error sources"}),
    (tdoa(PairsInOrder, toa_sigma=None, tdoa_sigma=1e-7), {"pairs"}),
    (OneAtATime(STATIONS, sigma=1e-7), {"batch"}),
    (InPlace(STATIONS, sigma=1e-7), {"pure"}),
    (WrongShape(STATIONS, sigma=1e-7), {"shapes"}),
    (IntegerAngles(STATIONS, sigma=1e-7), {"shapes"}),
]


@pytest.mark.parametrize(("model", "expected"), CASES, ids=lambda v: type(v).__name__)
def test_each_fault_is_caught_by_its_law(model, expected):
    assert {one.law for one in broken_laws(model, examples=10)} == expected


def test_asymmetric_noise_is_caught():
    assert "noise covariance" in {
        one.law for one in broken_laws(tdoa(AsymmetricNoise), examples=12)
    }


def test_rows_out_of_nowhere_are_caught():
    found = {one.law: one.message for one in broken_laws(tdoa(InventsRows), examples=12)}
    assert "row 0 is kept, but did not arrive" in found["independent rows"]


def test_the_report_of_a_diagonal_covariance():
    with pytest.raises(AssertionError) as caught:
        check_measurement_model(tdoa(DiagonalNoise), examples=12)
    text = str(caught.value)
    assert text.startswith("DiagonalNoise breaks 2 of the 17 laws of measurement models:")
    assert "reference: the information H' R^-1 H of any stations' differences" in text
    assert "information against station" in text
    assert "position = [" in text
    assert "time = " in text
    assert "stations heard = [" in text


def test_what_is_missing_is_named():
    with pytest.raises(AssertionError, match="NoOffset has no") as caught:
        check_measurement_model(NoOffset())
    assert "size" in str(caught.value)


def test_bad_arguments_must_be_refused():
    good = lambda: TDOA(STATIONS, toa_sigma=-1.0)  # noqa: E731
    check_measurement_model(tdoa(TDOA), bad_arguments=[good], examples=5)
    with pytest.raises(AssertionError, match=r"refusal: .*\n.*bad_arguments\[1\] raises nothing"):
        check_measurement_model(tdoa(TDOA), bad_arguments=[good, lambda: tdoa(TDOA)], examples=5)
    with pytest.raises(AssertionError, match=r"bad_arguments\[0\] raises ZeroDivisionError"):
        check_measurement_model(tdoa(TDOA), bad_arguments=[lambda: 1 / 0], examples=5)


def test_a_place_to_try_can_be_given():
    """A range from a mast that the kit does not know of, tried away from the mast only."""

    @attrs.frozen
    class Mast(Measurement):
        dims = 2
        size = 1

        def predict(self, position, velocity, time):
            if np.any(np.linalg.norm(position, axis=-1) < 1e3):
                raise RuntimeError("asked too close")
            return np.linalg.norm(position, axis=-1, keepdims=True)

        def jacobian(self, position, velocity, time):
            r = np.linalg.norm(position, axis=-1, keepdims=True)
            H = (position / r)[..., None, :]
            return H, np.zeros_like(H)

        def noise_covariance(self, position, velocity, time):
            return np.eye(1)

    away = kinematics(Mast()).filter(lambda k: np.linalg.norm(k.position) > 2e3)
    check_measurement_model(Mast(), kinematics=away, examples=12)
    with pytest.raises(AssertionError, match="predict raised RuntimeError: asked too"):
        check_measurement_model(Mast())
    still = Kinematics(np.array([3e3, 0.0]), np.zeros(2), 0.0)
    check_measurement_model(Mast(), kinematics=away.map(lambda k: still), examples=3)


def test_bearings_are_compared_around_the_circle():
    """A bearing's cut lies within the region; as an angle it passes, undeclared it does not."""

    @attrs.frozen(eq=False)
    class Bearing(Measurement):
        stations: Stations
        declared: bool = True
        dims = 2
        size = 1

        @property
        def angular(self):
            return np.array([self.declared])

        def predict(self, position, velocity, time):
            x, y = np.moveaxis(position - self.stations.positions[0], -1, 0)
            return np.arctan2(y, x)[..., None]

        def jacobian(self, position, velocity, time):
            x, y = np.moveaxis(position - self.stations.positions[0], -1, 0)
            H = (np.stack([-y, x], axis=-1) / (x**2 + y**2)[..., None])[..., None, :]
            return H, np.zeros_like(H)

        def noise_covariance(self, position, velocity, time):
            return 1e-6 * np.eye(1)

    one = Stations([[100.0, 50.0]])
    check_measurement_model(Bearing(one), examples=12)
    west = Kinematics(np.array([-900.0, 50.0]), np.zeros(2), 0.0)  # exactly on the cut
    places = kinematics(Position(dims=2)).map(lambda k: west)
    check_measurement_model(Bearing(one), kinematics=places, examples=12)
    with pytest.raises(AssertionError, match="position jacobian"):
        check_measurement_model(Bearing(one, declared=False), kinematics=places, examples=12)


def test_stations_that_are_never_all_known():
    t = [0.0, 10.0]
    apart = np.array([[[0.0, 0.0], [np.nan, 1.0]], [[np.nan, 0.0], [5e3, 1.0]]])
    never = TDOA(Stations(apart, times=t), toa_sigma=1e-7)
    with pytest.raises(AssertionError, match="no values could be drawn"):
        check_measurement_model(never)
    fine = Stations(np.zeros((2, 2, 2)) + np.array([[0.0, 0.0], [5e3, 0.0]]), times=t)
    elsewhere = TDOA(fine, toa_sigma=np.full((1, 2), 1e-7), sigma_times=[20.0])
    with pytest.raises(AssertionError, match="sigma_times: at none of these times"):
        check_measurement_model(elsewhere)


def test_fdoa_with_diagonal_noise():
    class Diagonal(FDOA):
        def sensor_covariance(self, time):
            return super().sensor_covariance(time) * np.eye(self.size)

    found = {one.law for one in broken_laws(Diagonal(STATIONS, range_rate_sigma=0.1), examples=12)}
    assert found == {"reference", "reference-free"}
