"""One case of Source C, many runs of it in one batch, and how soon it succeeds."""

from __future__ import annotations

from typing import Literal, get_args

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index
from imm_tdoa.gaussian_sum import settled
from imm_tdoa.reproduce.phase_difference.scenario import EMITTER, Scenario
from imm_tdoa.reproduce.phase_difference.switches import Switches

Average = Literal["rms", "mean"]
RESAMPLES = 200


@attrs.frozen(eq=False)
class Trial:
    """Runs of one case.

    Attributes
    ----------
    scenario : Scenario
        The case.
    position : (runs, T, 2)
        Estimates after each scan but the first, m.
    weight : (runs, T, N)
        Weights of the components.
    means : (T, N, 2)
        Components of the first run, m.
    """

    scenario: Scenario
    position: Array
    weight: Array
    means: Array

    @property
    def times(self) -> Array:
        """Times (T,) of the estimates, s."""
        return self.scenario.times[1:]

    @property
    def error_m(self) -> Array:
        """Position errors (runs, T), m."""
        return np.asarray(np.linalg.norm(self.position - EMITTER, axis=-1))

    @property
    def relative(self) -> Array:
        """Position errors (runs, T) as shares of the emitter's distance then."""
        return self.error_m / self.scenario.ranges[1:]

    @property
    def settled(self) -> Index:
        """Index (runs,) of the estimate that the source's output rule reports."""
        return settled(self.position, self.scenario.path[1:])

    def over_time(self, average: Average = "rms") -> Array:
        """Return the error (T,) averaged over the runs, as a share of the distance."""
        _validate.one_of("average", average, get_args(Average))
        power = 2.0 if average == "rms" else 1.0
        return np.asarray(np.mean(self.relative**power, axis=0) ** (1.0 / power))

    def at(self, time: float, average: Average = "rms") -> float:
        """Return the averaged error at `time` s, one of the times of the estimates."""
        return float(self.over_time(average)[self.index(time)])

    def index(self, time: float) -> int:
        """Return the estimate made at `time` s."""
        found = np.flatnonzero(np.isclose(self.times, time))
        if not len(found):
            raise ValueError(
                f"time: expected one of {self.times[0]:g} to {self.times[-1]:g} s in steps of "
                f"{self.times[1] - self.times[0]:g} s, got {time!r}"
            )
        return int(found[0])

    def time_below(self, share: float, average: Average = "rms") -> tuple[float, float]:
        """Return when the averaged error falls below `share` to stay, s, and a standard error.

        NaN where it does not within the time flown. The standard error is that of resampled runs
        (bootstrap), NaN where more than a twentieth of the resamples never fall below.
        """
        power = 2.0 if average == "rms" else 1.0
        runs = len(self.relative)
        drawn = np.random.default_rng(runs).multinomial(runs, np.full(runs, 1.0 / runs), RESAMPLES)
        curves = (drawn @ self.relative**power / runs) ** (1.0 / power)
        times = self._falls(curves, share)
        error = float(np.nanstd(times)) if np.mean(np.isnan(times)) < 0.05 else np.nan
        return float(self._falls(self.over_time(average)[None], share)[0]), error

    def _falls(self, curves: Array, share: float) -> Array:
        """Time from which each curve (..., T) stays below `share`; NaN where it never does."""
        above = curves >= share
        last = curves.shape[-1] - np.argmax(above[..., ::-1], axis=-1)  # one beyond the last above
        last = np.where(np.any(above, axis=-1), last, 0)
        late = last == curves.shape[-1]
        return np.where(late, np.nan, self.times[np.where(late, 0, last)])


def trial(
    scenario: Scenario, runs: int = 200, seed: int = 1, switches: Switches | None = None
) -> Trial:
    """Run one case.

    Parameters
    ----------
    scenario : Scenario
        The case.
    runs : int
        Monte-Carlo runs, at least 2.
    seed : int
        Seed of the errors.
    switches : Switches, optional
        How the Gaussian sum is made.
    """
    switches = Switches() if switches is None else switches
    values, bearing = scenario.draw(seed, runs)
    tracker = scenario.tracker(switches)
    start = tracker.start(0.0, *scenario.begin(values[:, 0], bearing, switches))
    rows = {"both": slice(0, 2), "phase": slice(0, 1), "rate": slice(1, 2)}[scenario.use]
    track = tracker.run(scenario.times[1:], values[:, 1:, rows], start)
    return Trial(scenario, track.position, track.weight, track.means[0])
