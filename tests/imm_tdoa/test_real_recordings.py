"""What the library makes of real recordings: aircraft, a car among satellites, rockets.

The figures asserted are those the project promises; what it measures is printed beside them
(``pytest -n 0 -rP tests/imm_tdoa/test_real_recordings.py``).
"""

from pathlib import Path

import attrs
import numpy as np
import pytest

from imm_tdoa import IMM, Bank, bankfile, metrics, recording
from imm_tdoa.locate import fix_scans
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity
from imm_tdoa.recording import Recording
from imm_tdoa.scans import Scans

DATA = Path(__file__).parents[3] / "shared" / "data"

pytestmark = [
    pytest.mark.recordings,
    pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside the project"),
]

FLIGHTS = ("2022-09-23_lora1", "2022-09-23_lora2", "2022-09-25_lora1", "2022-09-25_lora2")


def horizontal_rmse(bank: Bank, drive: Recording) -> float:
    measurement, times, values, pairs = drive.scans()
    track = IMM(bank, measurement, robust="student-t").run(times, values, pairs=pairs)
    truth, _ = drive.truth_at("phone", track.times)
    assert len(track.times) == 1985
    return float(metrics.rmse((track.position - truth)[:, :2]))


@pytest.mark.parametrize(("range_rates", "limit_m"), [(False, 10.0), (True, 4.6)])
def test_car_among_satellites(range_rates: bool, limit_m: float) -> None:
    """Satellites are the moving stations; a tuned gated CV filter gives 9.5 and 4.3 m."""
    drive = recording.read(DATA / "gnss_phone_drive")
    if not range_rates:
        drive = attrs.evolve(drive, range_rate=None)
    bank = bankfile.load("vehicle")
    ours = horizontal_rmse(bank, drive)
    alone = {
        f"ConstantVelocity(psd={psd:g})": horizontal_rmse(Bank([ConstantVelocity(psd=psd)]), drive)
        for psd in (0.3, 1.0)
    }
    alone["ConstantAcceleration(psd=0.5)"] = horizontal_rmse(
        Bank([ConstantAcceleration(psd=0.5)]), drive
    )
    best = min(alone, key=lambda name: alone[name])
    what = "arrival times and range rates" if range_rates else "arrival times alone"
    print(f"{what}: vehicle {ours:.2f} m, best single model {best} {alone[best]:.2f} m")
    assert ours <= limit_m
    assert ours < alone[best]


@pytest.mark.parametrize("flight", FLIGHTS)
def test_rocket_is_tracked_and_no_single_motion_foresees_it_better(flight: str) -> None:
    """No truth: the predictive likelihood of the same scans from the same start decides."""
    rec = recording.read(DATA / "rocket_lora" / flight)
    measurement, times, values, _ = rec.scans()
    bank = bankfile.load("rocket")
    track = IMM(bank, measurement, robust="gate").run(times, values)
    assert len(track.times) > 0.95 * len(times)
    assert np.isfinite(track.mean).all()
    height, spread = track.position[-1, 2], np.sqrt(track.covariance[-1, 2, 2])
    assert height > -3.0 * spread  # the receivers are in a plane: height is weakly observable
    first = len(times) - len(track.times)
    print(f"{flight}: IMM {track.log_likelihood[-1]:.1f}")
    for model, name in zip(bank.models, bank.names, strict=True):
        alone = IMM(
            Bank([model], birth_std=bank.birth_std, names=[name]), measurement, robust="gate"
        )
        start = alone.start(track.times[0], track.position[0], track.position_covariance[0])
        single = alone.run(times[first + 1 :], values[first + 1 :], start=start)
        print(f"  {name} alone {single.log_likelihood[-1]:.1f}")
        assert track.log_likelihood[-1] > single.log_likelihood[-1], name


def test_aircraft_fixes() -> None:
    """All 1413 messages; published quartiles for these files are 68, 184 and 488 m."""
    errors = []
    for k in range(1, 9):
        rec = recording.read(DATA / "locards_mlat" / f"set{k}")
        every = [(target, rec.scans(target)) for target in rec.targets]
        truth = np.concatenate([rec.truth_at(name, scans.times)[0] for name, scans in every])
        times = np.concatenate([scans.times for _, scans in every])
        values = np.concatenate([scans.values for _, scans in every])
        measurement = every[0][1].measurement
        scans = Scans.checked(measurement, times[:, None], values[:, None, :])
        fix = fix_scans(scans, robust="student-t")
        errors.append(np.linalg.norm((fix.position - truth)[:, :2], axis=-1))
    horizontal = np.concatenate(errors)
    assert len(horizontal) == 1413
    assert np.isfinite(horizontal).all()
    print("aircraft, quartiles of the horizontal error:", np.percentile(horizontal, [25, 50, 75]))
    assert np.all(np.percentile(horizontal, [25, 50, 75]) <= [32.0, 68.0, 170.0])
