"""A recording: stations, what they measured, and what is known of the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.recording import checks, gather, schema
from imm_tdoa.recording.sections import Noise, TruthScoring
from imm_tdoa.recording.table import Table
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations

NAMELESS = "emitter"  # what a lone target is called that nothing names


def _is_a(kind: type) -> Any:
    def check(_: Any, field: Any, value: Any) -> None:
        if not isinstance(value, kind):
            raise ValueError(f"{field.name}: expected {kind.__name__}, got {value!r}")

    return check


_optional = attrs.validators.optional


@attrs.frozen(eq=False)
class Recording:
    """What stations measured of one emitter or several.

    Parameters
    ----------
    stations : Stations
        The receivers, named, in 2 or 3 dimensions.
    title : str
        One line that says what this is.
    speed_mps : float
        Speed of the signal, m/s.
    labelled : bool
        Whether it is known which rows belong to one target.
    frame : EastNorthUp, optional
        Where on the Earth the axes are; None: local axes.
    noise : Noise
        Standard deviations of rows that have none of their own.
    truth_scoring : TruthScoring
        What of the truth scoring may use.
    tdoa, toa, fdoa, range_rate, height, truth : Table, optional
        Tables with the columns of the files of the same names; at least one of the first four.
    source, notes : mapping
        Where it comes from and what else there is to say, in values that TOML can hold.

    Raises
    ------
    ValueError
        A table that breaks its format, stations in one dimension, nothing measured.
    """

    stations: Stations = attrs.field(validator=_is_a(Stations))
    title: str = attrs.field(default="", validator=_is_a(str), kw_only=True)
    speed_mps: float = attrs.field(default=299792458.0, kw_only=True)
    labelled: bool = attrs.field(default=True, validator=_is_a(bool), kw_only=True)
    frame: EastNorthUp | None = attrs.field(
        default=None, validator=_optional(_is_a(EastNorthUp)), kw_only=True
    )
    noise: Noise = attrs.field(factory=Noise, validator=_is_a(Noise), kw_only=True)
    truth_scoring: TruthScoring = attrs.field(
        factory=TruthScoring, validator=_is_a(TruthScoring), kw_only=True
    )
    tdoa: Table | None = attrs.field(default=None, kw_only=True)
    toa: Table | None = attrs.field(default=None, kw_only=True)
    fdoa: Table | None = attrs.field(default=None, kw_only=True)
    range_rate: Table | None = attrs.field(default=None, kw_only=True)
    height: Table | None = attrs.field(default=None, kw_only=True)
    truth: Table | None = attrs.field(default=None, kw_only=True)
    source: Mapping[str, Any] = attrs.field(factory=dict, kw_only=True)
    notes: Mapping[str, Any] = attrs.field(factory=dict, kw_only=True)

    __repr__ = brief

    def __attrs_post_init__(self) -> None:
        if self.dims not in (2, 3):
            raise ValueError(f"stations: expected 2 or 3 dimensions, got {self.dims}")
        object.__setattr__(self, "speed_mps", _validate.positive("speed_mps", self.speed_mps))
        axes = self.truth_scoring.axes
        if axes is not None and "z" in axes and self.dims == 2:
            raise ValueError("truth.axes: expected x and y alone where dims = 2, got z")
        for name in schema.TABLES:
            table = getattr(self, name)
            if table is not None:
                object.__setattr__(self, name, self._checked(name, table))
        if not self.measured:
            raise ValueError(
                f"recording: nothing measured; expected at least one of "
                f"{', '.join(schema.MEASURED)}"
            )
        if self.height is not None and self.dims == 2:
            raise ValueError(f"{self.height.file}: a height needs dims = 3")
        if self.labelled:
            self._refuse_half_labelled()

    def _checked(self, name: str, table: Table) -> Table:
        if not isinstance(table, Table):
            raise ValueError(f"{name}: expected a Table, got {table!r}")
        if not table.file:
            table = attrs.evolve(table, file=name)
        axes = self.truth_scoring.axes
        flat = axes is not None and "z" not in axes
        columns = schema.columns(name, self.dims, flat_truth=flat)
        schema.check_columns(table, columns, table.file)
        table = schema.check_values(table, columns)
        if name == "truth":
            checks.check_increasing(table, "target")
        else:
            checks.check_measured(table, self.stations.names, labelled=self.labelled)
        return table

    def _refuse_half_labelled(self) -> None:
        """Refuse a table without targets beside one that names several."""
        without = [t for t in self.measured.values() if "target" not in t]
        for table in self.measured.values():
            if without and "target" in table and len(set(table["target"].tolist())) > 1:
                raise ValueError(
                    f"{without[0].file}: target: missing column, where {table.file} names "
                    f"several targets"
                )

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return self.stations.dims

    @property
    def measured(self) -> dict[str, Table]:
        """The tables of measurements of stations, and of heights beside them."""
        tables = {name: getattr(self, name) for name in schema.MEASURED}
        found = {name: table for name, table in tables.items() if table is not None}
        if found and self.height is not None:
            found["height"] = self.height
        return found

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets, in order of first appearance.

        Where rows name no target there is one: it has the name of the truth's target where the
        truth has just one, else ``emitter``.
        """
        first: dict[str, float] = {}
        if self.labelled:
            for table in self.measured.values():
                if "target" in table:
                    rows = np.sort(np.unique(table["target"], return_index=True)[1])
                    for row in rows.tolist():
                        name, time = str(table["target"][row]), float(table["time_s"][row])
                        first[name] = min(first.get(name, np.inf), time)
        if first:
            return tuple(sorted(first, key=lambda name: first[name]))
        true = self._true_targets()
        return true if len(true) == 1 else (NAMELESS,)

    def _true_targets(self) -> tuple[str, ...]:
        return () if self.truth is None else tuple(dict.fromkeys(self.truth["target"].tolist()))

    def scans(self, target: str | None = None) -> Scans:
        """Return what was measured of a target, scan by scan, as a filter takes it.

        Everything measured at one time is one scan: the rows of one emission and the
        differences of the same ``time_s``. Two emissions at exactly the same time are two scans.
        Columns are, as far as the recording has them: arrival times (one per station), range
        rates (one per station), the height, time differences, range-rate differences; several
        kinds make a `Stack`. Differences have as many columns as there are pairs at one time at
        most; where pairs change from scan to scan, `pairs` says which they are.

        A row's own standard deviation goes before ``[noise]``; standard deviations of times are
        at least ``sigma_floor_s``, and ``bias_sigma_s`` is added in quadrature: a lasting error
        is treated as if it were new with each scan. Where two scans at the same time give a
        station different standard deviations, both get the larger.

        Parameters
        ----------
        target : str, optional
            Which one; may be left out where there is only one.

        Returns
        -------
        Scans
            ``measurement, times (T,), values (T, m), pairs (T, m, 2) or None``.

        Raises
        ------
        ValueError
            No such target, rows that have no standard deviation, rows that nobody has told
            apart: of several emitters, or of one and false alarms. `imm_tdoa.Tracker` takes
            these.
        """
        target = self._target(target)
        if not self.labelled:
            self._refuse_unassociated()
        return gather.scans(self, target)

    def _target(self, target: str | None) -> str:
        targets = self.targets
        if target is None:
            if len(targets) > 1:
                raise ValueError(
                    f"target: expected the name of one of {len(targets)} targets: "
                    f"{schema.known(targets)}"
                )
            return targets[0]
        if target not in targets:
            raise ValueError(f"target: no target {target!r}; there are {schema.known(targets)}")
        return target

    def _refuse_unassociated(self) -> None:
        """Refuse rows of several emitters, and rows that may be nobody's."""
        tables = self.measured.values()
        named = {n for t in tables if "target" in t for n in t["target"].tolist()}
        count = max(len(named), len(self._true_targets()))
        if count == 1 and all("target" in t for t in tables):
            return
        rows = {
            0: "the rows are of nobody knows how many emitters",
            1: "the rows may be of one emitter and false alarms",
        }
        raise ValueError(
            f"recording.toml: labelled: false, and "
            f"{rows.get(count, f'the rows are of {count} emitters')}: imm-tdoa track (in Python, "
            f"Tracker) finds out which are whose; where all are of one emitter, set labelled = true"
        )

    def truth_times(self, target: str | None = None) -> Array:
        """Return the times (K,) of a target's truth rows, s; empty where it has none.

        Parameters
        ----------
        target : str, optional
            Whose; not needed where there is one.
        """
        rows = self._truth_rows(target)
        return np.zeros(0) if self.truth is None else np.asarray(self.truth["time_s"][rows])

    def truth_at(self, target: str | None, times: Any) -> tuple[Array, Array | None]:
        """Return the true position (T, d), m, and velocity (T, d), m/s, of a target.

        Between two rows of the truth, the straight line, or the cubic Hermite curve where the
        truth has velocities; NaN before the first and after the last, where two rows are further
        apart than ``max_gap_s``, and in a z that the truth does not have.

        Parameters
        ----------
        target : str or None
            Which one; None where there is only one.
        times : (T,)
            Times, s.

        Returns
        -------
        position : (T, d)
        velocity : (T, d) or None
            None where the truth has no velocities.
        """
        times = _validate.array("times", times, ("T",))
        rows = self._truth_rows(target)
        table, d = self.truth, self.dims
        if table is None or not len(rows):
            return np.full((len(times), d), np.nan), None
        place = [n for n in schema.positions(d) if n in table]
        speed = [n for n in schema.velocities(d) if n in table]
        path = Stations(
            np.stack([table[n][rows] for n in place], axis=-1)[:, None, :],
            velocities=np.stack([table[n][rows] for n in speed], axis=-1)[:, None, :]
            if len(speed) == len(place)
            else None,
            times=table["time_s"][rows],
        )
        position, velocity = (a[:, 0, :] for a in path.at(times))
        position, velocity = (self._padded(a, times, path) for a in (position, velocity))
        return position, None if path.velocities is None else velocity

    def _padded(self, a: Array, times: Array, path: Stations) -> Array:
        """NaN over gaps in the truth, and for a z it does not have."""
        assert path.times is not None
        gap = self.truth_scoring.max_gap_s
        if gap is not None:
            after = np.searchsorted(path.times, times, side="left").clip(0, len(path.times) - 1)
            before = np.searchsorted(path.times, times, side="right").clip(1) - 1
            wide = path.times[after] - path.times[before] > gap
            a = np.where(wide[:, None], np.nan, a)
        missing = np.full((len(a), self.dims - a.shape[1]), np.nan)
        return np.concatenate([a, missing], axis=1)

    def _truth_rows(self, target: str | None) -> Any:
        if target is None or target not in self._true_targets():
            target = self._target(target)
        if self.truth is None:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(self.truth["target"] == target)
