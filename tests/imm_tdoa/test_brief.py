"""Objects full of arrays show themselves by shapes."""

from __future__ import annotations

import numpy as np

from imm_tdoa import IMM, Bank, Stations, locate
from imm_tdoa.models import TDOA, ConstantVelocity, Static

PLACES = [[0, 0], [9_000, 1_000], [4_000, 8_000], [-3_000, 6_000]]


def test_few_numbers_are_shown_many_are_counted() -> None:
    stations = Stations(PLACES)
    shown = repr(stations)
    assert shown.startswith("Stations(positions=[[ 0., 0.], [ 9000., 1000.],")
    assert "\n" not in shown
    fix = locate.gauss_newton(stations, np.zeros((100, 3)), toa_sigma=1e-8)
    assert repr(fix).startswith("Fix(position=<100 x 2>, velocity=None, covariance=<100 x 2 x 2>")
    moving = Stations([PLACES] * 9, velocities=np.zeros((9, 4, 2)), times=range(9))
    assert "positions=<9 x 4 x 2>" in repr(moving)


def test_a_track_fits_on_a_screen() -> None:
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)], mean_sojourn=9.0)
    stations = Stations(PLACES)
    r = np.linalg.norm(stations.positions - [2000.0, 3000.0], axis=1) / 299792458.0
    imm = IMM(bank, TDOA(stations, toa_sigma=1e-8))
    track = imm.run(np.arange(50.0), np.tile(r[1:] - r[0], (50, 1)))
    assert "mode_means=(<50 x 2>, <50 x 4>)" in repr(track)
    assert "bank=Bank(models=(Static(psd=1.0, std=None), " in repr(track)
    assert "birth_std={'velocity': 100.0, " in repr(bank)
    assert len(repr(track)) < 1500
    assert len(repr(imm.start(0.0, np.zeros(2), np.eye(2)))) < 1500
