"""Where filters start when nobody says where: a fix of the first scans, shared by all banks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from imm_tdoa import initiation
from imm_tdoa.contract import AXES, Array, Index, component_names
from imm_tdoa.imm import IMM
from imm_tdoa.scans import Scans
from imm_tdoa.study.draw import Drawn

Text = np.ndarray[Any, np.dtype[np.object_]]


class Fixes(NamedTuple):
    """Fixes of n runs.

    Attributes
    ----------
    time : (n,)
        Time of the fix, s.
    mean, covariance : (n, c), (n, c, c)
        Of the position, and of the velocity where the banks have one.
    components : tuple of c str
        Names of the columns.
    last : (n,) int
        The last scan that the fix used.
    reason : (n,) str
        Why there is none; empty where there is one.
    """

    time: Array
    mean: Array
    covariance: Array
    components: tuple[str, ...]
    last: Index
    reason: Text

    def part(self, runs: Index) -> Fixes:
        """Return the fixes of some runs."""
        return self._replace(
            time=self.time[runs],
            mean=self.mean[runs],
            covariance=self.covariance[runs],
            last=self.last[runs],
            reason=self.reason[runs],
        )


class Begin:
    """The fixes of a chunk's runs, each kind made once: what is known of the velocity differs.

    Parameters
    ----------
    drawn : Drawn
        What was measured.
    """

    def __init__(self, drawn: Drawn) -> None:
        self.drawn = drawn
        self._made: dict[tuple[float, ...], Fixes] = {}

    def of(self, imm: IMM) -> Fixes:
        """Return the fixes for an estimator."""
        std = initiation.velocity_std(imm.bank, imm.space)
        key = () if std is None else tuple(float(s) for s in std)
        if key not in self._made:
            self._made[key] = _fixes(imm, self.drawn, moving=std is not None)
        return self._made[key]


def _fixes(imm: IMM, drawn: Drawn, moving: bool) -> Fixes:
    n, d = len(drawn.seeds), drawn.ways.dims
    names = component_names(d, 1) if moving else AXES[:d]
    c = len(names)
    made = Fixes(
        time=np.zeros(n),
        mean=np.zeros((n, c)),
        covariance=np.zeros((n, c, c)),
        components=tuple(names),
        last=np.zeros(n, dtype=np.int64),
        reason=np.full(n, "", dtype=object),
    )

    def fill(runs: Index) -> None:
        part = drawn.part(runs)
        scans = Scans.checked(part.measurement, part.times, part.values, part.pairs)
        state, last = initiation.start_from_scans(imm, scans)
        mode = next(j for j, own in enumerate(state.space.modes) if set(names) <= set(own))
        at = np.array([state.space.modes[mode].index(name) for name in names])
        made.time[runs] = state.time
        made.mean[runs] = state.means[mode][..., at]
        made.covariance[runs] = state.covariances[mode][..., at[:, None], at]
        made.last[runs] = last

    each(fill, np.arange(n), made.reason)
    return made


def each(work: Callable[[Index], None], runs: Index, reason: Text) -> None:
    """Do some work on all runs as one batch; where that raises, on halves, down to single runs.

    Those with which it cannot be done have the reason recorded; the others are as if they had
    never been there.
    """
    if not len(runs):
        return
    try:
        work(runs)
    except (MemoryError, OSError):  # not the run's fault
        raise
    except Exception as error:
        if len(runs) == 1:
            reason[runs[0]] = " ".join(f"{type(error).__name__}: {error}".split())
            return
        for half in np.array_split(runs, 2):
            each(work, half, reason)
