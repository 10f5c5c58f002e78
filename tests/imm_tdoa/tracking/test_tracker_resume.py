"""A tracker that was saved and resumed goes on bit by bit as if nothing had happened."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from tracker_cases import BANK, MEASUREMENT, scan

from imm_tdoa import Bank, Tracker
from imm_tdoa.models import TDOA, ConstantVelocity
from imm_tdoa.tracking import Hits


def same(a, b):
    assert list(a) == list(b)
    assert dict(a.lives) == dict(b.lives)
    assert a.ignored == b.ignored
    assert a.rejected == b.rejected
    assert dict(a.rows) == dict(b.rows)
    assert a.on_trial == b.on_trial
    for name in a:
        for field in ("times", "mean", "covariance", "log_likelihood", "nis", "row_weight"):
            assert_array_equal(getattr(a[name], field), getattr(b[name], field))


@settings(deadline=None, max_examples=6)
@given(
    seed=st.integers(0, 2**32 - 1),
    at=st.integers(0, 8),
    targets=st.integers(0, 3),
    detection=st.sampled_from([0.7, 0.95]),
    associator=st.sampled_from(["global", "jpda"]),
)
def test_resumed_is_uninterrupted(tmp_path_factory, seed, at, targets, detection, associator):
    rng = np.random.default_rng(seed)
    scans = [scan(rng, k, slice(0, targets), detection=detection) for k in range(9)]
    path = tmp_path_factory.mktemp("saved") / "tracker.npz"
    whole = Tracker(BANK, MEASUREMENT, associator=associator)
    for s in scans[:at]:
        whole.step(s)
    whole.save(path)
    resumed = Tracker(BANK, MEASUREMENT, associator=associator).resume(path)
    for s in scans[at:]:
        whole.step(s)
        resumed.step(s)
    same(resumed.tracks, whole.tracks)


def saved(tmp_path):
    tracker = Tracker(BANK, MEASUREMENT)
    rng = np.random.default_rng(0)
    for k in range(3):
        tracker.step(scan(rng, k))
    tracker.save(tmp_path / "tracker.npz")
    return tmp_path / "tracker.npz"


def test_nothing_in_the_file_is_pickled(tmp_path):
    with np.load(saved(tmp_path), allow_pickle=False) as archive:
        for name in archive.files:
            assert archive[name].dtype.kind in "biuf"


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (Tracker(BANK, MEASUREMENT, confirmation=Hits()), "settings.confirmation"),
        (Tracker(BANK, TDOA(MEASUREMENT.stations, toa_sigma=80e-9)), "toa_sigma"),
        (Tracker(BANK, MEASUREMENT, overload=30.0), "settings.overload was 20.0, here it is 30.0"),
        (Tracker(Bank([ConstantVelocity(psd=2.0)]), MEASUREMENT), "settings.imm.bank"),
    ],
)
def test_a_tracker_with_other_settings_is_refused(tmp_path, other, difference):
    with pytest.raises(ValueError, match="other settings") as error:
        other.resume(saved(tmp_path))
    assert difference in str(error.value)


def test_what_is_no_tracker_is_refused(tmp_path):
    tracker = Tracker(BANK, MEASUREMENT)
    with pytest.raises(ValueError, match=r"nowhere\.npz: there is no such file"):
        tracker.resume(tmp_path / "nowhere.npz")
    (tmp_path / "text.npz").write_text("nothing")
    with pytest.raises(ValueError, match=r"text\.npz: expected a saved tracker"):
        tracker.resume(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npz: expected a saved tracker"):
        tracker.resume(tmp_path / "other.npz")
    path = saved(tmp_path)
    (tmp_path / "half.npz").write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=r"half\.npz: expected a saved tracker"):
        tracker.resume(tmp_path / "half.npz")
    assert zipfile.is_zipfile(path)
