"""One scan against several modes: rows that count, shared offsets, the bank's innovation."""

from __future__ import annotations

import attrs
import numpy as np
from imm_oracles import mixture_moments
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.contract import Measurement
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantVelocity,
    Position,
    RangeRate,
    Stack,
    Static,
)
from imm_tdoa.observation import mixture_innovation, observe, without_offsets

CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS, velocities=np.full((5, 2), 3.0))
HERE = np.arange(2)
NONE = np.arange(0)


def against(measurement, values, x=((700.0, 900.0, 5.0, -3.0),), time=0.0):
    x = [np.array(a) for a in x]
    velocity = [HERE + 2 if a.shape[-1] >= 4 else NONE for a in x]
    return observe(measurement, x, [HERE] * len(x), velocity, time, np.asarray(values))


@attrs.frozen
class Bearing(Measurement):
    """Direction from the origin, rad: an angular row."""

    @property
    def dims(self):
        return 2

    @property
    def size(self):
        return 1

    @property
    def angular(self):
        return np.array([True])

    def predict(self, position, velocity, time):
        return np.arctan2(position[..., 1], position[..., 0])[..., None]

    def jacobian(self, position, velocity, time):
        square = np.sum(position**2, axis=-1)
        H = np.stack([-position[..., 1] / square, position[..., 0] / square], axis=-1)
        return H[..., None, :], np.zeros((*position.shape[:-1], 1, 2))

    def noise_covariance(self, position, velocity, time):
        return np.full((*position.shape[:-1], 1, 1), 1e-4)


def test_values_become_metres_and_rows_their_place_in_the_state():
    tdoa = TDOA(STATIONS, toa_sigma=1e-8)
    z = np.full(4, 1e-6)
    seen = against(tdoa, z)
    p = np.array([700.0, 900.0])
    assert_allclose(seen.nu[0], z * 299_792_458.0 - tdoa.predict(p, np.zeros(2), 0.0), rtol=1e-15)
    assert_allclose(seen.H[0][:, :2], tdoa.jacobian(p, np.zeros(2), 0.0)[0], rtol=1e-15)
    assert_array_equal(seen.H[0][:, 2:], 0.0)
    assert_array_equal(seen.group, [-1] * 4)


def test_velocity_rows_see_the_velocity_and_zero_where_a_mode_has_none():
    fdoa = FDOA(STATIONS, range_rate_sigma=0.1)
    seen = against(fdoa, np.zeros(4), x=[(700.0, 900.0), (700.0, 900.0, 0.0, 0.0)])
    assert_array_equal(seen.nu[0], seen.nu[1])
    assert seen.H[0].shape == (4, 2)
    assert_array_equal(seen.H[0], seen.H[1][:, :2])
    assert np.abs(seen.H[1][:, 2:]).max() > 0.1


def test_angles_are_wrapped():
    seen = against(Bearing(), [np.pi - 0.01], x=[(-100.0, -1.0)])
    assert_allclose(seen.nu[0], [-0.01 - np.arctan(0.01)], rtol=1e-9)
    imm = IMM(Bank([Static(psd=0.0)]), Bearing())
    state = imm.step(imm.start(0.0, [-100.0, -1.0], 25.0 * np.eye(2)), 0.0, [np.pi - 0.01])
    assert abs(state.mean[1] - 1.0) < 0.2
    assert state.nis < 1.0


def test_rows_missing_throughout_are_cut_out_and_others_masked():
    tdoa = TDOA(STATIONS, toa_sigma=1e-8)
    z = np.array([[1e-6, np.nan, 0.0, np.nan], [1e-6, np.nan, np.nan, 0.0]])
    seen = against(tdoa, z, x=[np.tile([700.0, 900.0], (2, 1))])
    assert seen.nu[0].shape == (2, 3)
    assert seen.R[0].shape[-2:] == (3, 3)
    assert_array_equal(seen.present, [[True, True, False], [True, False, True]])


def test_a_station_that_is_not_heard_takes_its_rows_along_in_every_mode():
    t = np.array([0.0, 10.0])
    moving = Stations(np.stack([CORNERS, CORNERS + 1.0]), times=t)
    gone = moving.positions.copy()
    gone[1, 3] = np.nan
    some = Stations(gone, times=t)
    z = np.array([1e-6, 2e-6, 3e-6, 1e-6])
    seen = against(TDOA(some, toa_sigma=1e-8), z, time=5.0)
    assert_array_equal(seen.present, [True, True, False, True])
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)])
    P = 1e4 * np.eye(2)
    deaf, cut = IMM(bank, TDOA(some, toa_sigma=1e-8)), IMM(bank, TDOA(moving, toa_sigma=1e-8))
    a = deaf.step(deaf.start(0.0, [700.0, 900.0], P), 5.0, z)
    b = cut.step(cut.start(0.0, [700.0, 900.0], P), 5.0, np.where(np.arange(4) == 2, np.nan, z))
    assert_allclose(a.mean, b.mean, rtol=1e-12)
    assert_allclose(a.log_likelihood, b.log_likelihood, rtol=1e-12)
    outside = deaf.step(deaf.start(0.0, [700.0, 900.0], P), 11.0, z)
    assert outside.nis_dof == 0
    assert_allclose(outside.log_likelihood, 0.0, atol=1e-15)


@attrs.frozen
class Fence(Measurement):
    """The position, measured only east of x = 0 and as y only north of y = 0."""

    @property
    def dims(self):
        return 2

    @property
    def size(self):
        return 2

    def predict(self, position, velocity, time):
        return np.where(position > 0.0, position, np.nan)

    def jacobian(self, position, velocity, time):
        H = np.broadcast_to(np.eye(2), (*position.shape[:-1], 2, 2))
        return H, np.zeros_like(H)

    def noise_covariance(self, position, velocity, time):
        return np.broadcast_to(np.eye(2), (*position.shape[:-1], 2, 2))


def test_a_row_that_one_mode_cannot_foresee_counts_in_none():
    """Likelihoods of different rows do not compare, so all modes score the same ones."""
    for x in ([(-1.0, 2.0), (3.0, 4.0)], [(3.0, 4.0), (-1.0, 2.0)]):
        assert_array_equal(against(Fence(), [1.0, 1.0], x=x).present, [False, True])
    neither = against(Fence(), [1.0, 1.0], x=[(-1.0, 2.0), (3.0, -4.0)])
    assert not neither.present.any()


def test_rows_that_close_a_loop_do_not_count():
    tdoa = TDOA(STATIONS, toa_sigma=1e-8, pairs=[[1, 0], [2, 0], [2, 1], [3, 0]])
    z = np.full(4, 1e-7)
    assert_array_equal(against(tdoa, z).present, [True, True, False, True])
    z[0] = np.nan
    assert_array_equal(against(tdoa, z).present, [True, True, True])
    independent = TDOA(STATIONS, tdoa_sigma=1e-8, pairs=tdoa.pairs)
    assert against(independent, np.full(4, 1e-7)).present.all()


def test_without_offsets_keeps_offset_free_rows_and_counts_one_less_per_group():
    stack = Stack(TOA(STATIONS, sigma=1e-8), RangeRate(STATIONS, sigma=0.1), Position(3.0))
    z = np.concatenate([np.full(5, 1e-6), np.full(5, 2.0), [710.0, 905.0]])
    z[1] = z[6] = z[7] = np.nan
    seen = against(stack, z, x=[(700.0, 900.0, 5.0, -3.0), (690.0, 880.0)])
    free = without_offsets(seen)
    assert np.count_nonzero(free.present) == 9 - 2
    assert_array_equal(free.group, -1)
    for a, b in zip(seen.nu, free.nu, strict=True):
        assert_array_equal(a[-2:], b[-2:])
    shifted = z.copy()
    shifted[:5] += 0.123  # seconds: 37 000 km
    shifted[5:10] += 5e4
    other = without_offsets(against(stack, shifted, x=[(700.0, 900.0, 5.0, -3.0), (690.0, 880.0)]))
    for a, b, H, K in zip(free.nu, other.nu, free.H, other.H, strict=True):
        assert_allclose(a[free.present], b[free.present], atol=1e-6)
        assert_array_equal(H, K)


def test_the_banks_innovation_is_the_mixture_of_the_modes():
    rng = np.random.default_rng(0)
    tdoa = TDOA(STATIONS, toa_sigma=1e-8)
    z = np.array([1e-6, -2e-6, 5e-7, 0.0])
    seen = against(tdoa, z, x=[(700.0, 900.0), (720.0, 870.0, 1.0, 1.0)])
    P = []
    for n in (2, 4):
        A = rng.normal(size=(n, n))
        P.append(A @ A.T)
    weight = np.array([0.3, 0.7])
    nu, S = mixture_innovation(seen, weight, P)
    Ss = [H @ C @ H.T + R for H, C, R in zip(seen.H, P, seen.R, strict=True)]
    want = mixture_moments(list(weight), list(seen.nu), Ss)
    assert_allclose(nu, want[0], rtol=1e-13)
    assert_allclose(S, want[1], rtol=1e-8)
    dropped = attrs.evolve(seen, present=np.array([True, False, True, True]))
    nu, S = mixture_innovation(dropped, weight, P)
    assert (nu[1], S[1, 1]) == (0.0, 1.0)
    assert_array_equal(S[1, [0, 2, 3]], 0.0)
