"""Aircraft messages whose aircraft is hidden from the tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imm_tdoa import Tracker, bankfile, metrics, recording

DATA = Path(__file__).parents[4] / "shared" / "data" / "locards_mlat" / "set5"

pytestmark = [
    pytest.mark.recordings,
    pytest.mark.skipif(not DATA.is_dir(), reason="the recording is not beside the project"),
]


def test_hidden_labels_are_found_again():
    data = recording.without_labels(recording.read(DATA))
    _, scans = recording.unlabelled(data)
    tracks = Tracker(bankfile.load("aircraft")).run(data)
    labels = tracks.labels(scans)
    names = sorted({label for own in labels.values() for label in own})
    number = {name: k for k, name in enumerate(names)}
    purity = [metrics.purity(np.array([number[v] for v in own])) for own in labels.values()]
    rows = sum(len(own) for own in labels.values())
    print(
        f"{len(scans)} messages, {len(tracks)} tracks of {rows} rows, mean purity "
        f"{np.mean(purity):.3f}, ignored {tracks.ignored}"
    )
    assert len(tracks) >= 1
    assert np.mean(purity) > 0.7
