"""The estimators of a study: banks by name, file or inline, with the options of `IMM`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import tomli_w

from imm_tdoa import _structure, bankfile, registry
from imm_tdoa.bank import MIXING, Bank
from imm_tdoa.contract import MeasurementModel
from imm_tdoa.cycle import ROBUST, UPDATES
from imm_tdoa.imm import IMM
from imm_tdoa.mixing import MERGING
from imm_tdoa.study import sweep

CONTENT = ("modes", "mean_sojourn_s", "transition", "prior", "mixing", "birth_std")
OPTIONS = ("update", "merging", "robust", "gate_probability", "degrees_of_freedom", "reopen_after")
FACTORS = ("process_noise_factor", "sojourn_factor")
SWEPT = (*FACTORS, "mixing", "update", "merging", "robust")
CHOICES: Mapping[str, tuple[str, ...]] = {
    "mixing": MIXING,
    "update": UPDATES,
    "merging": MERGING,
    "robust": ("none", *ROBUST),
}


@attrs.frozen(eq=False)
class BankCase:
    """One estimator of a study.

    Attributes
    ----------
    name : str
        What tables call it.
    point : mapping
        Swept parameters of the bank and their values here; empty where nothing was swept.
    bank : Bank
        Its models; of a single model a bank of one mode.
    options : mapping
        What `IMM` takes besides: update, merging, robust, ….
    """

    name: str
    point: Mapping[str, Any]
    bank: Bank
    options: Mapping[str, Any]

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of its modes."""
        return self.bank.names

    def imm(self, measurement: MeasurementModel) -> IMM:
        """Return the estimator on a measurement model."""
        return IMM(self.bank, measurement, **self.options)


@attrs.frozen(kw_only=True)
class BankEntry:
    """A ``[[banks]]`` table of a study file, references resolved.

    Parameters
    ----------
    name : str
        What tables call it; sweeps append their values.
    bank : str, optional
        A preset or the path of a bank file; `content` goes before what that says.
    modes, mean_sojourn_s, transition, prior, mixing, birth_std
        As in a bank file. A single model is a bank of one mode.
    update, merging, robust, gate_probability, degrees_of_freedom, reopen_after
        As for `IMM`; ``robust = "none"`` is the default.
    process_noise_factor : float
        Factor on the density of every mode's process noise (the variance, where a mode has
        ``std``).
    sojourn_factor : float
        Factor on the mean sojourn times.
    sweep : mapping
        Values of process_noise_factor, sojourn_factor, mixing, update, merging, robust: one
        estimator for every combination.
    """

    name: str
    bank: str | None = None
    modes: tuple[Mapping[str, Any], ...] | None = None
    mean_sojourn_s: Any = None
    transition: tuple[tuple[float, ...], ...] | None = None
    prior: tuple[float, ...] | None = None
    mixing: str | None = None
    birth_std: Mapping[str, float] | None = None
    update: str | None = None
    merging: str | None = None
    robust: str | None = None
    gate_probability: float | None = None
    degrees_of_freedom: float | None = None
    reopen_after: int | None = None
    process_noise_factor: float = 1.0
    sojourn_factor: float = 1.0
    sweep: Mapping[str, tuple[Any, ...]] = attrs.field(factory=dict)


def resolved(entry: BankEntry, folder: Path | None) -> dict[str, Any]:
    """Return the entry as a table that refers to nothing: presets and files written out.

    Parameters
    ----------
    entry : BankEntry
        What the study file says.
    folder : Path, optional
        Where relative paths begin: the folder of the study file.

    Raises
    ------
    ValueError
        No such preset or file; a bank file that is none; no modes at all.
    """
    given = attrs.asdict(entry, filter=lambda _, value: value is not None)
    table = {key: value for key, value in given.items() if key not in ("bank", *FACTORS)}
    table.update({key: given[key] for key in FACTORS if given[key] != 1.0})
    if entry.bank is not None:
        found = bankfile.SHELF.find(entry.bank, folder)
        bankfile.parse(found.text, found.file)  # refuses what is no bank, in its own words
        table = {**_structure.parse(found.text, found.file), **table}
    elif entry.modes is None:
        raise ValueError("bank: missing; expected a preset, a file, or modes")
    if not table["sweep"]:
        del table["sweep"]
    result: dict[str, Any] = _plain(table)
    return result


def _plain(value: Any) -> Any:
    """Return mappings and tuples as what TOML makes of them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def cases(table: Mapping[str, Any], place: str) -> list[BankCase]:
    """Return the estimators of a resolved table, one per point of its sweep.

    Parameters
    ----------
    table : mapping
        As `resolved` returns it.
    place : str
        What messages call it, such as ``study.toml: banks[0]``.
    """
    swept = table.get("sweep", {})
    for key, values in swept.items():
        if key not in SWEPT:
            hint = _structure.near(key, SWEPT)
            raise ValueError(
                f"{place}.sweep.{key}: no parameter of a bank{hint}; there are: {', '.join(SWEPT)}"
            )
        if not values:
            raise ValueError(f"{place}.sweep.{key}: expected at least one value, got none")
    result = []
    for point in sweep.points(swept):
        full = {**table, **point}
        for key, choices in CHOICES.items():
            if full.get(key, choices[0]) not in choices:
                where = f"sweep.{key}" if key in point else key
                listed = ", ".join(repr(choice) for choice in choices)
                raise ValueError(f"{place}.{where}: expected one of {listed}, got {full[key]!r}")
        for key in FACTORS:
            factor = full.get(key, 1.0)
            ok = isinstance(factor, int | float) and not isinstance(factor, bool)
            if not ok or not 0.0 < factor < np.inf:
                where = f"sweep.{key}" if key in point else key
                raise ValueError(f"{place}.{where}: expected a number above 0, got {factor!r}")
        bank = made(full, place)
        options = {key: full[key] for key in OPTIONS if key in full and full[key] != "none"}
        try:
            IMM(bank, registry.load("position")(sigma=1.0, dims=2), **options)
        except ValueError as error:
            raise ValueError(f"{place}.{error}") from error
        result.append(BankCase(sweep.label(str(table["name"]), point), point, bank, options))
    return result


def made(table: Mapping[str, Any], place: str) -> Bank:
    """Return the bank of a table with a bank file's keys and the two factors."""
    content = {key: table[key] for key in CONTENT if key in table}
    content["modes"] = [
        _noisier(mode, float(table.get("process_noise_factor", 1.0))) for mode in table["modes"]
    ]
    longer = float(table.get("sojourn_factor", 1.0))
    if longer != 1.0:
        if "transition" in content:
            raise ValueError(f"{place}.sojourn_factor: the bank has a transition matrix instead")
        sojourn = content.get("mean_sojourn_s", 60.0)
        many = isinstance(sojourn, list)
        content["mean_sojourn_s"] = [longer * s for s in sojourn] if many else longer * sojourn
    try:
        return bankfile.parse(tomli_w.dumps(content), place)
    except ValueError as error:
        text = str(error)
        joint = f"{place}: "
        own = text.removeprefix(joint)
        key = own.partition(":")[0].partition("[")[0].partition(".")[0]
        raise ValueError(f"{place}.{own}" if key in CONTENT else text) from error


def _noisier(mode: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """One [[modes]] table with the variance of its process noise multiplied."""
    if factor == 1.0:
        return dict(mode)
    power = {key: 1.0 if key.endswith("psd") else 0.5 for key in mode if _is_noise(key)}
    return {k: v * factor ** power[k] if k in power else v for k, v in mode.items()}


def _is_noise(key: str) -> bool:
    return key == "std" or key == "psd" or key.endswith(("_psd", "_std"))
