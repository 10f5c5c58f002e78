"""Which of several single models a criterion chooses, run by run (ALGORITHMS §11)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtrc

from imm_tdoa.contract import Array, Index
from imm_tdoa.scans import Scans
from imm_tdoa.selection import begin
from imm_tdoa.selection.best_fit import maximise, weighted
from imm_tdoa.study.banks import BankCase
from imm_tdoa.study.draw import Drawn
from imm_tdoa.study.plan import Criterion
from imm_tdoa.track import Track


def wanted(criteria: Sequence[Criterion]) -> frozenset[str]:
    """Return the names of the banks whose batch maximum likelihood is needed."""
    return frozenset(
        name for criterion in criteria if criterion.by in ("aic", "bic") for name in criterion.banks
    )


class Fits:
    """AIC and BIC of a bank of one mode in every run; infinite where there is no maximum.

    Parameters
    ----------
    case : BankCase
        The bank.
    runs : int
        Number of runs n.

    Attributes
    ----------
    aic, bic : (n,)
        The least is the best.
    seconds : float
        Time that it took.
    """

    def __init__(self, case: BankCase, runs: int) -> None:
        self.model = case.bank.models[0]
        self.aic, self.bic = np.full(runs, np.inf), np.full(runs, np.inf)
        self.seconds = 0.0

    def add(self, runs: Index, drawn: Drawn, track: Track) -> None:
        """Work out those of the runs numbered `runs`, which begin where `track` suggests."""
        begun = time.perf_counter()
        scans = Scans.checked(drawn.measurement, drawn.times, drawn.values, drawn.pairs)
        starts = begin.initial_states(self.model, track, 0, scans)
        fit = maximise(weighted(self.model, scans), starts)
        self.aic[runs] = np.where(np.isnan(fit.aic), np.inf, fit.aic)
        self.bic[runs] = np.where(np.isnan(fit.bic), np.inf, fit.bic)
        self.seconds += time.perf_counter() - begun


def choose(
    criteria: Sequence[Criterion],
    banks: Sequence[BankCase],
    figures: Mapping[str, Array],
    fits: Mapping[str, Fits],
) -> Index:
    """Return which of its banks each criterion chooses in each run, (C, n); -1 where it cannot.

    Parameters
    ----------
    criteria : sequence of Criterion
        The rules.
    banks : sequence of BankCase
        All the study's, in the order of `figures`.
    figures : mapping of str to (B, n)
        Log-likelihood, nis and nis_dof of every bank in every run.
    fits : mapping of str to Fits
        By bank, its AIC and BIC.
    """
    names = [case.name for case in banks]
    n = figures["log_likelihood"].shape[1]
    chosen = np.full((len(criteria), n), -1, dtype=np.int64)
    for c, criterion in enumerate(criteria):
        index = np.array([names.index(name) for name in criterion.banks])
        if criterion.by == "nis":
            nis, dof = figures["nis"][index], figures["nis_dof"][index]
            usable = np.isfinite(nis) & (dof > 0.0)
            tail = chdtrc(np.where(usable, dof, 1.0), np.where(usable, nis, 0.0))
            accepted = usable & (tail >= criterion.level)
            best = np.where(accepted.any(axis=0), np.argmax(accepted, axis=0), len(index) - 1)
            chosen[c] = np.where(usable.all(axis=0), best, -1)
            continue
        if criterion.by == "log_evidence":
            cost = -figures["log_likelihood"][index]
        else:
            cost = np.stack([getattr(fits[name], criterion.by) for name in criterion.banks])
        cost = np.where(np.isfinite(cost), cost, np.inf)
        usable = np.isfinite(cost).all(axis=0)
        chosen[c] = np.where(usable, np.argmin(cost, axis=0), -1)
    return chosen
