"""The runs of one scenario, added up chunk by chunk: nothing here grows with their number."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import Array
from imm_tdoa.study.results.moments import Joint, Moments

PER_RUN = (
    "position_mse",
    "velocity_mse",
    "position_error",
    "nees",
    "nis",
    "nis_dof",
    "log_likelihood",
    "mode_hit",
    "recognition_delay_s",
)
AVERAGED = (
    "position_mse",
    "velocity_mse",
    "position_error",
    "nees",
    "mode_hit",
    "recognition_delay_s",
)
PER_SCAN = ("position_square", "velocity_square", "nees", "mode_probability")

Chunk = Mapping[str, NDArray[Any]]


@attrs.frozen(eq=False)
class Scans:
    """Sums over runs, per bank and scan.

    Attributes
    ----------
    count : (B, T)
        Runs behind each sum.
    total, square : (B, T) or (B, T, r)
        Sums of the quantity and of its square.
    """

    count: Array
    total: Array
    square: Array

    def merged(self, other: Scans) -> Scans:
        """Return the sums over both."""
        return Scans(self.count + other.count, self.total + other.total, self.square + other.square)

    @property
    def mean(self) -> Array:
        """Mean over the runs, NaN where there is none."""
        n = self._count(least=1)
        return np.asarray(self.total / n)

    @property
    def variance(self) -> Array:
        """Variance over the runs, NaN where there are fewer than two."""
        n = self._count(least=2)
        return np.asarray(np.maximum(self.square - self.total**2 / n, 0.0) / (n - 1.0))

    def _count(self, least: int) -> Array:
        n = np.where(self.count >= least, self.count, np.nan)
        return n if self.total.ndim == n.ndim else n[..., None]


@attrs.frozen(eq=False)
class Gathered:
    """What the runs of one scenario come to.

    Attributes
    ----------
    runs : int
        Runs gathered.
    times : (T,)
        Times of the scans, s.
    dims : int
        Dimensions of a position.
    moments : dict of str to Moments
        Of each averaged per-run figure, (B,).
    pairs : Joint
        Of the mean squared errors of every two banks, (B, B): what they are ranked by.
    evidence : Joint
        Of the log-likelihoods of every two banks, (B, B).
    nis : Joint
        Of the sum of normalised innovations squared and its degrees of freedom, (B,).
    margin : Moments
        Of the log-likelihood of the best bank over the second, ().
    wins, judged : (B,), ()
        Runs in which each bank has the largest log-likelihood, of so many.
    failed : (B,)
        Runs that failed.
    selected : (B, r)
        Runs by the mode that had most of the probability.
    chosen : (C, K)
        Runs by criterion and which of its candidates it chose.
    scans : dict of str to Scans
        Sums per scan.
    """

    runs: int
    times: Array
    dims: int
    moments: dict[str, Moments]
    pairs: Joint
    evidence: Joint
    nis: Joint
    margin: Moments
    wins: Array
    judged: Array
    failed: Array
    selected: Array
    chosen: Array
    scans: dict[str, Scans]

    @classmethod
    def of(cls, chunk: Chunk, candidates: int, ranked_by: str) -> Gathered:
        """Return the sums over the runs of one chunk; arguments as for `gather`."""
        evidence = _float(chunk, "log_likelihood")
        probability = _scans(chunk, "mode_probability")
        r = probability.total.shape[-1]
        leader, margin = _leader(evidence)
        B = len(evidence)
        chosen = np.asarray(chunk.get("selected_model", np.zeros((0, 0))))
        return cls(
            runs=evidence.shape[1],
            times=_float(chunk, "times"),
            dims=int(chunk["dims"]),
            moments={name: Moments.of(_float(chunk, name)) for name in AVERAGED},
            pairs=Joint.pairs(_float(chunk, f"{ranked_by}_mse")),
            evidence=Joint.pairs(evidence),
            nis=Joint.of(_float(chunk, "nis"), _float(chunk, "nis_dof")),
            margin=Moments.of(margin),
            wins=np.bincount(leader[leader >= 0], minlength=B).astype(float),
            judged=np.asarray(np.count_nonzero(leader >= 0), dtype=float),
            failed=np.count_nonzero(chunk["failed"], axis=-1).astype(float),
            selected=_counts(np.asarray(chunk["selected"]), r),
            chosen=_counts(chosen, candidates),
            scans={name: _scans(chunk, name) for name in PER_SCAN},
        )

    def merged(self, other: Gathered) -> Gathered:
        """Return the sums over both."""
        return Gathered(
            runs=self.runs + other.runs,
            times=self.times,
            dims=self.dims,
            moments={name: m.merged(other.moments[name]) for name, m in self.moments.items()},
            pairs=self.pairs.merged(other.pairs),
            evidence=self.evidence.merged(other.evidence),
            nis=self.nis.merged(other.nis),
            margin=self.margin.merged(other.margin),
            wins=self.wins + other.wins,
            judged=self.judged + other.judged,
            failed=self.failed + other.failed,
            selected=self.selected + other.selected,
            chosen=self.chosen + other.chosen,
            scans={name: s.merged(other.scans[name]) for name, s in self.scans.items()},
        )


def gather(chunks: Iterable[Chunk], candidates: int, ranked_by: str) -> Gathered | None:
    """Add up the chunks of one scenario.

    Parameters
    ----------
    chunks : iterable of mapping
        In the order of the runs, which decides the last bits.
    candidates : int
        The most that any criterion chooses from.
    ranked_by : "position" or "velocity"
        The error by which banks are compared.

    Returns
    -------
    Gathered or None
        None where there is no chunk.
    """
    whole: Gathered | None = None
    for chunk in chunks:
        part = Gathered.of(chunk, candidates, ranked_by)
        whole = part if whole is None else whole.merged(part)
    return whole


def _leader(evidence: Array) -> tuple[NDArray[np.int64], Array]:
    """Bank with the largest log-likelihood (n,), and its lead over the second, nats.

    -1 and NaN in runs that are not known for every bank, or where there is no second.
    """
    B, n = evidence.shape
    known = np.isfinite(evidence).all(axis=0)
    if B < 2 or not n:
        return np.full(n, -1), np.full(n, np.nan)
    ranked = np.sort(np.where(known, evidence, 0.0), axis=0)
    leader = np.where(known, np.argmax(np.where(known, evidence, 0.0), axis=0), -1)
    return leader, np.where(known, ranked[-1] - ranked[-2], np.nan)


def _counts(choice: NDArray[Any], size: int) -> Array:
    """How often each of `size` things is chosen (..., size); -1 is no choice."""
    picked = choice[..., None] == np.arange(size)
    return np.asarray(np.count_nonzero(picked, axis=-2), dtype=float)


def _scans(chunk: Chunk, name: str) -> Scans:
    return Scans(*(_float(chunk, f"{kind}_{name}") for kind in ("count", "sum", "sum2")))


def _float(chunk: Chunk, name: str) -> Array:
    return np.asarray(chunk[name], dtype=float)
