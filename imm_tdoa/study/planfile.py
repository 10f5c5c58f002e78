"""How a TOML file spells a study.

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
from pathlib import Path
from typing import Any

import attrs

from imm_tdoa import _structure
from imm_tdoa._shelf import Shelf
from imm_tdoa.simulate import _checks
from imm_tdoa.study import banks as bank_tables
from imm_tdoa.study import scenarios as scenario_tables
from imm_tdoa.study.banks import BankCase, BankEntry
from imm_tdoa.study.plan import METRICS, Criterion, Study
from imm_tdoa.study.scenarios import ScenarioEntry

SHELF = Shelf("study", "shipped study", "study/studies")


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


def shipped() -> tuple[str, ...]:
    """Return the names of the studies that ship with the package."""
    return SHELF.names()


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
    found = SHELF.find(name_or_path)
    return parse(found.text, found.file, folder=found.folder, runs=runs, seed=seed)


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

    Raises
    ------
    ValueError
        What is wrong with it, and where.
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
