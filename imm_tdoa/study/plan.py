"""A study: scenarios, banks, how many runs of each, and what makes two studies the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import tomli_w

from imm_tdoa.simulate import _checks
from imm_tdoa.study.banks import BankCase
from imm_tdoa.study.scenarios import ScenarioCase

METRICS = ("position", "velocity", "nees", "nis", "modes")
RULES = ("aic", "bic", "log_evidence", "nis")
BATCH, MOST = 30_000, 250  # scans and runs of a chunk, where the study does not say
WORDS = ("title", "question", "reading", "notes", "confidence", "metrics")  # change no number


@attrs.frozen(kw_only=True)
class Criterion:
    """A rule that chooses one of several single models in every run (``[[criteria]]``).

    Parameters
    ----------
    name : str
        What tables call it.
    by : "aic", "bic", "log_evidence" or "nis"
        The least AIC or BIC of the batch maximum likelihood; the largest evidence of the filters;
        the first bank whose innovations are not too large (one-sided), the last where all are.
    banks : sequence of str
        Names of banks of one mode, the simplest first.
    level : float
        Probability that ``"nis"`` rejects a model that is right.
    """

    name: str = attrs.field(validator=_checks.name)
    by: str = attrs.field(validator=_checks.one_of(*RULES))
    banks: tuple[str, ...]
    level: float = attrs.field(default=0.05, validator=_checks.probability)


@attrs.frozen(kw_only=True, eq=False)
class Study:
    """Everything that `run` needs; `load` and `parse` make one.

    Attributes
    ----------
    title, question, reading, notes : str
        What it is, what it asks, how its figures are to be read, whatever else there is to say.
    seed : int
        Where all random numbers come from.
    runs : int
        Runs of every scenario.
    chunk : int or None
        Runs of a chunk; without it as many as `chunk_of` says.
    metrics : tuple of str
        Of `METRICS`, those to report; banks are ranked by the first.
    criteria : tuple of Criterion
        Rules that choose between single models.
    confidence : float
        Of the intervals.
    scenarios : tuple of ScenarioCase
        One per point of every sweep.
    banks : tuple of BankCase
        The estimators, likewise.
    table : mapping
        The study file with all that it refers to written out; a study file itself.
    """

    title: str
    question: str
    reading: str
    notes: str
    seed: int
    runs: int
    chunk: int | None
    metrics: tuple[str, ...]
    criteria: tuple[Criterion, ...]
    confidence: float
    scenarios: tuple[ScenarioCase, ...]
    banks: tuple[BankCase, ...]
    table: Mapping[str, Any]

    @property
    def text(self) -> str:
        """The study as a TOML file that refers to nothing."""
        return tomli_w.dumps(dict(self.table))

    def scenario(self, name: str) -> ScenarioCase:
        """Return the scenario of that name.

        Parameters
        ----------
        name : str
            What tables call it.

        Raises
        ------
        ValueError
            There is none of that name.
        """
        for case in self.scenarios:
            if case.name == name:
                return case
        raise ValueError(f"scenario: the study has none called {name!r}")

    def chunk_of(self, case: ScenarioCase) -> int:
        """Return the number of runs of a scenario's chunks; the study alone decides it.

        Parameters
        ----------
        case : ScenarioCase
            One of `scenarios`.
        """
        if self.chunk is not None:
            return self.chunk
        return max(1, min(MOST, BATCH // case.scans))

    def chunks(self, case: ScenarioCase) -> list[tuple[int, int]]:
        """Return the first run of each chunk and the run after its last.

        Parameters
        ----------
        case : ScenarioCase
            One of `scenarios`.
        """
        size = self.chunk_of(case)
        return [(first, min(first + size, self.runs)) for first in range(0, self.runs, size)]


def differences(old: Any, new: Any, place: str = "") -> list[str]:
    """Return in words where two resolved study tables differ, words for readers left out.

    Parameters
    ----------
    old, new : tables, lists, numbers, texts
        As `Study.table` holds them.
    place : str
        Where in the study they are; nothing for the whole.
    """
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        keys = [*old, *(key for key in new if key not in old)]
        dot = f"{place}." if place else ""
        parts = [
            differences(old.get(key), new.get(key), f"{dot}{key}")
            for key in keys
            if place or key not in WORDS
        ]
        return [line for part in parts for line in part]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [line for i, (a, b) in pairs for line in differences(a, b, f"{place}[{i}]")]
    if old == new:
        return []
    return [f"{place}: was {_short(old)}, is {_short(new)}"]


def _short(value: Any) -> str:
    if value is None:
        return "absent"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
