"""The scenarios of a study: shipped ones, files or tables, with what the study changes in them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _structure, simulate
from imm_tdoa.bank import Bank
from imm_tdoa.simulate import Scenario, _checks, shelf
from imm_tdoa.study import banks, sweep

# What drawing understands; anything else that a scenario may say must be at its default.
DRAWN = (
    *("title", "notes", "track_with", "dims", "speed_mps", "seed", "frame", "stations", "sampling"),
    *("noise", "clock", "dropouts", "outliers", "targets"),
)


@attrs.frozen(kw_only=True)
class Start:
    """How filters start, where it is not by a fix made of the first scans (``[scenarios.start]``).

    Parameters
    ----------
    position_std_m : float
        They are told the true first position, with an error of this standard deviation, m, per
        axis, drawn for every run; then every scan is an update.
    velocity_std_mps : float, optional
        The same of the velocity, for banks that have one.
    """

    position_std_m: float = attrs.field(validator=_checks.above_zero)
    velocity_std_mps: float | None = attrs.field(default=None, validator=_checks.above_zero)


@attrs.frozen(kw_only=True)
class ScenarioEntry:
    """A ``[[scenarios]]`` table of a study file.

    Parameters
    ----------
    name : str, optional
        What tables call it, a sweep's values appended; default the scenario's name.
    scenario : str or mapping
        A shipped scenario, the path of a scenario file, or a whole scenario as a table.
    replace : mapping
        Tables that take the place of the scenario's own: targets, noise, sampling, ….
    change : mapping
        One value for each of some parameters; `sweep.PARAMETERS` lists them.
    sweep : mapping
        Several values for each of some parameters: a scenario for every combination.
    target : str, optional
        Which of the scenario's targets; without it run i takes target i, counted round.
    random : mapping, optional
        The way is not that of the legs but drawn for every run: a bank file's keys, or
        ``bank = NAME``. The target switches between these motions as the chain says, with their
        process noise; what a motion brings is drawn from the birth law. It starts at the target's
        position, with the target's velocity where there is one.
    start : table, optional
        See `Start`.
    score_from_s : float, optional
        Errors count from then on, s; without it from the second scan on (the first makes the
        fix), or from the first one where `start` is given.
    """

    name: str | None = None
    scenario: Any
    replace: Mapping[str, Any] = attrs.field(factory=dict)
    change: Mapping[str, Any] = attrs.field(factory=dict)
    sweep: Mapping[str, tuple[Any, ...]] = attrs.field(factory=dict)
    target: str | None = None
    random: Mapping[str, Any] | None = None
    start: Start | None = None
    score_from_s: float | None = None


@attrs.frozen(eq=False)
class ScenarioCase:
    """One scenario of a study.

    Attributes
    ----------
    name : str
        What tables call it.
    base : str
        The same without the sweep's values.
    point : mapping
        Swept parameters and their values here; empty where nothing was swept.
    plan : simulate.Scenario
        Stations, targets, errors; one target, or several that runs take in turn.
    random : Bank or None
        The motions that the way is drawn from.
    start : Start or None
        How filters start.
    score_from_s : float or None
        From when on errors count, s.
    """

    name: str
    base: str
    point: Mapping[str, Any]
    plan: Scenario
    random: Bank | None
    start: Start | None
    score_from_s: float | None

    @property
    def key(self) -> str:
        """The name as part of a file's name."""
        return key_of(self.name)

    @property
    def scans(self) -> int:
        """Number of scans T."""
        target, sampling = self.plan.targets[0], self.plan.sampling
        begin = max(target.start_s, sampling.start_s)
        first = np.ceil((begin - sampling.start_s) / sampling.interval_s - 1e-9)
        end = target.end_s - sampling.start_s - sampling.jitter_s
        return int(np.floor(end / sampling.interval_s + 1e-9) - first) + 1


def key_of(name: str) -> str:
    """Return a scenario's name as part of a file's name."""
    return re.sub(r"[^\w.+=-]", "_", name, flags=re.ASCII).lstrip(".-") or "_"


def resolved(entry: ScenarioEntry, folder: Path | None) -> dict[str, Any]:
    """Return the entry as a table that refers to nothing: scenarios and banks written out.

    Raises
    ------
    ValueError
        No such scenario; a file that is none; no bank to draw the way from.
    """
    content, name = _scenario(entry.scenario, folder)
    table: dict[str, Any] = {"name": entry.name or name}
    unknown = next((key for key in entry.replace if key not in _known()), None)
    if unknown is not None:
        hint = _structure.near(unknown, _known())
        raise ValueError(f"replace.{unknown}: a scenario has no such table{hint}")
    table["scenario"] = {**content, **_listed(entry.replace)}
    for key in ("change", "sweep"):
        if getattr(entry, key):
            table[key] = _listed(getattr(entry, key))
    for key in ("target", "score_from_s"):
        if getattr(entry, key) is not None:
            table[key] = getattr(entry, key)
    if entry.start is not None:
        table["start"] = attrs.asdict(entry.start, filter=lambda _, value: value is not None)
    if entry.random is not None:
        table["random"] = _random(entry.random, folder)
    return table


def _known() -> list[str]:
    return [field.name for field in attrs.fields(Scenario)]


def _listed(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _listed(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_listed(item) for item in value]
    return value


def _scenario(given: Any, folder: Path | None) -> tuple[dict[str, Any], str]:
    """Return the table of a scenario and what it is called by default."""
    if isinstance(given, Mapping):
        return _listed(given), str(given.get("title", "scenario"))
    if not isinstance(given, str):
        raise ValueError(f"scenario: expected a name, a file or a table, got {given!r}")
    found = shelf.SHELF.find(given, folder)
    simulate.read(found.text, found.file)  # refuses what is none, in its own words
    return _structure.parse(found.text, found.file), Path(found.file).stem


def _random(given: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    entry = _structure.structure({"name": "random", **given}, banks.BankEntry, "random")
    try:
        table = banks.resolved(entry, folder)
    except ValueError as error:
        raise ValueError(f"random.{error}") from error
    odd = [key for key in table if key not in ("name", *banks.CONTENT, *banks.FACTORS)]
    if odd:
        raise ValueError(f"random.{odd[0]}: a way is drawn from models and their chain alone")
    del table["name"]
    return table


def cases(table: Mapping[str, Any], place: str, layouts: sweep.Layouts) -> list[ScenarioCase]:
    """Return the scenarios of a resolved table, one per point of its sweep.

    Parameters
    ----------
    table : mapping
        As `resolved` returns it.
    place : str
        What messages call it, such as ``study.toml: scenarios[0]``.
    layouts : mapping
        Positions of stations by name.
    """
    plan = _structure.structure(table["scenario"], Scenario, f"{place}.scenario")
    change, swept = table.get("change", {}), table.get("sweep", {})
    for kind, keys in (("change", change), ("sweep", swept)):
        for key in keys:
            if key not in sweep.PARAMETERS:
                hint = _structure.near(key, sweep.PARAMETERS)
                raise ValueError(
                    f"{place}.{kind}.{key}: no parameter of a scenario{hint}; there are: "
                    f"{', '.join(sweep.PARAMETERS)}"
                )
    for key, values in swept.items():
        if not values:
            raise ValueError(f"{place}.sweep.{key}: expected at least one value, got none")
    start = None
    if "start" in table:
        start = _structure.structure(table["start"], Start, f"{place}.start")
    base = str(table["name"])
    result = []
    for point in sweep.points(swept):
        here, random = plan, table.get("random")
        for key, value in {**change, **point}.items():
            at = f"sweep.{key}[{swept[key].index(value)}]" if key in point else f"change.{key}"
            try:
                if key == "sojourn_s" and random is not None:
                    random = _staying(random, value)
                else:
                    here = sweep.turn(here, key, value, layouts)
            except ValueError as error:
                raise ValueError(f"{place}.{at}: {error}") from error
        bank = None if random is None else banks.made(random, f"{place}.random")
        here = _one_way(here, table.get("target"), bank is not None, place)
        name = sweep.label(base, point)
        case = ScenarioCase(name, base, point, here, bank, start, table.get("score_from_s"))
        if case.scans < 2:
            raise ValueError(f"{place}: {name!r} has fewer than two scans")
        result.append(case)
    return result


def _staying(random: Mapping[str, Any], value: Any) -> dict[str, Any]:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < np.inf:
        raise ValueError(f"expected a number above 0, got {value!r}")
    rest = {key: item for key, item in random.items() if key != "transition"}
    return {**rest, "mean_sojourn_s": float(value)}


def _one_way(plan: Scenario, target: str | None, random: bool, place: str) -> Scenario:
    """Return the scenario with the targets that runs take, or refuse what cannot be drawn."""
    for field in attrs.fields(Scenario):
        make = getattr(field.default, "factory", None)
        usual = field.default if make is None else make()
        if field.name not in DRAWN and getattr(plan, field.name) != usual:
            raise ValueError(f"{place}.scenario.{field.name}: a study cannot draw this")
    targets = plan.targets
    if target is not None:
        targets = tuple(t for t in plan.targets if t.name == target)
        if not targets:
            known = ", ".join(t.name for t in plan.targets)
            raise ValueError(f"{place}.target: there is no target {target!r}; there are: {known}")
    spans = {(t.start_s, t.end_s) for t in targets}
    if len(spans) > 1:
        raise ValueError(
            f"{place}.target: the targets exist at different times; choose one of "
            f"{', '.join(t.name for t in targets)}"
        )
    moving = any(station.moving for station in plan.stations)
    if moving and plan.sampling.jitter_s > 0.0:
        raise ValueError(
            f"{place}.scenario.sampling.jitter_s: a study draws no jitter where stations move"
        )
    if random and any(leg.acceleration_psd > 0.0 for t in targets for leg in t.legs):
        raise ValueError(f"{place}.random: the target's legs have an acceleration_psd as well")
    return attrs.evolve(plan, targets=targets)
