"""Where targets truly were."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.recording import Recording


@attrs.frozen(eq=False)
class Truth:
    """Where a target truly was: times (K,) s, positions (K, d) m, NaN where not known."""

    times: Array
    position: Array

    @classmethod
    def of(cls, recording: Recording | None, target: str | None) -> Truth | None:
        """Return a target's truth, or None where the recording has none."""
        if recording is None or recording.truth is None:
            return None
        times = recording.truth_times(target)
        return cls(times, recording.truth_at(target, times)[0]) if len(times) else None

    def during(self, times: Array) -> Truth:
        """Return the part within `times`, one row more on either side."""
        first = max(int(np.searchsorted(self.times, times[0], side="right")) - 1, 0)
        last = int(np.searchsorted(self.times, times[-1])) + 1
        return Truth(self.times[first:last], self.position[first:last])
