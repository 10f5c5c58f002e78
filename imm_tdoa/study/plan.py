"""A study: scenarios, banks and how many runs, and how a TOML file spells them.

::

    title = "When does a turn need a turn model?"
    question = "…"                       # in words, for the report
    seed = 1
    runs = 1000

    [[scenarios]]
    name = "turn"
    scenario = "sample"                  # a shipped scenario, a file, or a whole one as a table

    [scenarios.sweep]                    # every combination becomes a scenario
    interval_s = [1.0, 3.0]
    noise_factor = [1.0, 4.0]

    [[banks]]
    name = "vehicle"
    bank = "vehicle"                     # a preset, a file, or modes written here

    [[banks]]
    name = "straight on"
    modes = [{ model = "constant-velocity", psd = 1.0 }]

Relative paths begin at the study file. `Criterion`, `ScenarioEntry` and `BankEntry` say what else
there may be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import attrs
import tomli_w

from imm_tdoa import _structure
from imm_tdoa.simulate import _checks
from imm_tdoa.study import banks as bank_tables
from imm_tdoa.study import scenarios as scenario_tables
from imm_tdoa.study.banks import BankCase, BankEntry
from imm_tdoa.study.scenarios import ScenarioCase, ScenarioEntry

METRICS = ("position", "velocity", "nees", "nis", "modes")
RULES = ("aic", "bic", "log_evidence", "nis")
BATCH, MOST = 30_000, 250  # scans and runs of a chunk, where the study does not say
WORDS = ("title", "question", "reading", "notes", "confidence", "metrics")  # change no number
_SHELF = resources.files("imm_tdoa.study").joinpath("studies")


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


@attrs.frozen(kw_only=True)
class _File:
    """The tables of a study file."""

    title: str
    question: str = ""
    reading: str = ""
    notes: str = ""
    seed: int = attrs.field(default=0, validator=_checks.whole)
    runs: int = attrs.field(default=100, validator=_checks.above_zero)
    chunk: int | None = attrs.field(default=None, validator=_checks.above_zero)
    metrics: tuple[str, ...] = METRICS
    confidence: float = attrs.field(default=0.95, validator=_checks.probability)
    layouts: Mapping[str, tuple[tuple[float, ...], ...]] = attrs.field(factory=dict)
    scenarios: tuple[ScenarioEntry, ...] = ()
    banks: tuple[BankEntry, ...] = ()
    criteria: tuple[Criterion, ...] = ()

    def __attrs_post_init__(self) -> None:
        for i, metric in enumerate(self.metrics):
            if metric not in METRICS:
                raise ValueError(
                    f"metrics[{i}]: expected one of {', '.join(METRICS)}, got {metric!r}"
                )
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(
                f"confidence: expected a probability between 0 and 1, got {self.confidence:g}"
            )
        for name in ("scenarios", "banks"):
            if not getattr(self, name):
                raise ValueError(f"{name}: expected at least one [[{name}]] table, got none")


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
        """Return the scenario of that name."""
        for case in self.scenarios:
            if case.name == name:
                return case
        raise ValueError(f"scenario: the study has none called {name!r}")

    def chunk_of(self, case: ScenarioCase) -> int:
        """Return the number of runs of a scenario's chunks; the study alone decides it."""
        if self.chunk is not None:
            return self.chunk
        return max(1, min(MOST, BATCH // case.scans))

    def chunks(self, case: ScenarioCase) -> list[tuple[int, int]]:
        """Return the first run of each chunk and the run after its last."""
        size = self.chunk_of(case)
        return [(first, min(first + size, self.runs)) for first in range(0, self.runs, size)]


def shipped() -> tuple[str, ...]:
    """Return the names of the studies that ship with the package."""
    return tuple(sorted(f.name[:-5] for f in _SHELF.iterdir() if f.name.endswith(".toml")))


def load(name_or_path: str | Path, *, runs: int | None = None, seed: int | None = None) -> Study:
    """Return a shipped study or one from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        The name of a shipped study (`shipped` lists them), or the path of a file. A shipped name
        goes before a file of the same name; write ``./name`` for the file.
    runs, seed : int, optional
        In the place of the file's.

    Raises
    ------
    ValueError
        Neither shipped nor a file; a file that is no study. The message says where in the file
        (``study.toml: scenarios[0].sweep.noise_factor[1]: …``), what was wrong and what was
        expected.
    """
    if isinstance(name_or_path, str) and name_or_path in shipped():
        text = _SHELF.joinpath(f"{name_or_path}.toml").read_text("utf-8")
        return parse(text, f"{name_or_path}.toml", runs=runs, seed=seed)
    path = Path(name_or_path)
    if path.is_dir():
        raise ValueError(f"study: {str(name_or_path)!r} is a folder; expected a TOML file")
    if path.is_file():
        text = _structure.read(path)
        return parse(text, path.name, folder=path.parent, runs=runs, seed=seed)
    if isinstance(name_or_path, Path) or path.suffix == ".toml" or len(path.parts) != 1:
        raise ValueError(f"study: there is no file {str(name_or_path)!r}")
    raise ValueError(
        f"study: no study ships under the name {name_or_path!r} and there is no such "
        f"file{_structure.near(name_or_path, shipped())}; there are: {', '.join(shipped())}"
    )


def parse(
    text: str,
    file: str = "study",
    *,
    folder: Path | None = None,
    runs: int | None = None,
    seed: int | None = None,
) -> Study:
    """Return the study written in `text` (TOML).

    Parameters
    ----------
    text : str
        The content of a study file.
    file : str
        What messages call it.
    folder : Path, optional
        Where relative paths in it begin.
    runs, seed : int, optional
        In the place of the file's.
    """
    table = _structure.parse(text, file)
    table.update({key: n for key, n in (("runs", runs), ("seed", seed)) if n is not None})
    content = _structure.structure(table, _File, file)
    table["scenarios"] = [
        _placed(f"{file}: scenarios[{i}]", scenario_tables.resolved, entry, folder)
        for i, entry in enumerate(content.scenarios)
    ]
    table["banks"] = [
        _placed(f"{file}: banks[{i}]", bank_tables.resolved, entry, folder)
        for i, entry in enumerate(content.banks)
    ]
    scenarios = [
        case
        for i, entry in enumerate(table["scenarios"])
        for case in scenario_tables.cases(entry, f"{file}: scenarios[{i}]", content.layouts)
    ]
    banks = [
        case
        for i, entry in enumerate(table["banks"])
        for case in bank_tables.cases(entry, f"{file}: banks[{i}]")
    ]
    _refuse_repeats(f"{file}: scenarios", [case.key for case in scenarios])
    _refuse_repeats(f"{file}: banks", [case.name for case in banks])
    _check_criteria(file, content.criteria, banks)
    return Study(
        title=content.title,
        question=content.question,
        reading=content.reading,
        notes=content.notes,
        seed=content.seed,
        runs=content.runs,
        chunk=content.chunk,
        metrics=content.metrics,
        criteria=content.criteria,
        confidence=content.confidence,
        scenarios=tuple(scenarios),
        banks=tuple(banks),
        table=table,
    )


def _placed(place: str, function: Any, entry: Any, folder: Path | None) -> dict[str, Any]:
    try:
        result: dict[str, Any] = function(entry, folder)
    except ValueError as error:
        raise ValueError(f"{place}.{error}") from error
    return result


def _refuse_repeats(place: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{place}: two of them are called {name!r}; give each its own name")


def _check_criteria(file: str, criteria: Sequence[Criterion], banks: Sequence[BankCase]) -> None:
    sizes = {case.name: len(case.bank) for case in banks}
    for i, criterion in enumerate(criteria):
        place = f"{file}: criteria[{i}].banks"
        if len(criterion.banks) < 2:
            raise ValueError(f"{place}: expected at least two banks to choose from")
        for name in criterion.banks:
            if name not in sizes:
                hint = _structure.near(name, sizes)
                raise ValueError(
                    f"{place}: there is no bank {name!r}{hint}; there are: {', '.join(sizes)}"
                )
            if sizes[name] != 1:
                raise ValueError(
                    f"{place}: {name!r} has {sizes[name]} modes; a criterion chooses between "
                    f"single models"
                )


def differences(old: Any, new: Any, place: str = "") -> list[str]:
    """Return in words where two resolved study tables differ, words for readers left out."""
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
