"""Where an emitter really goes, how it is measured there, and which motion is when."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.bank import Bank
from imm_tdoa.bounds.fix import fisher_information
from imm_tdoa.contract import Array, LinearMotion, MeasurementModel, MotionModel, component_names
from imm_tdoa.scans import Scans
from imm_tdoa.statespace import StateSpace


@attrs.frozen(eq=False)
class Course:
    """True states at the times of the scans, and the sequence of modes; made by `checked`.

    Attributes
    ----------
    bank : Bank
        The models.
    scans : Scans
        When and what is measured; a value that is NaN is missing.
    sequence : tuple of T int
        The mode in force over the step that ends at each scan.
    states : (..., T, c)
        True states.
    names : tuple of c str
        Their components.
    axes : tuple of int
        Batch axes, counted from the last (-1), to average over.
    """

    bank: Bank
    scans: Scans
    sequence: tuple[int, ...]
    states: Array
    names: tuple[str, ...]
    axes: tuple[int, ...]

    @classmethod
    def checked(
        cls,
        models: Any,
        measurement: MeasurementModel,
        times: Any,
        trajectory: Any,
        *,
        modes: Sequence[int | str] | None,
        components: Sequence[str] | None,
        present: Any,
        pairs: Any,
        axis: int | tuple[int, ...] | None,
    ) -> Course:
        """Return the course, or raise a ValueError that names what does not fit."""
        if isinstance(measurement, type) or not isinstance(measurement, MeasurementModel):
            raise ValueError(f"measurement: no measurement model: {measurement!r}")
        bank = models
        if not isinstance(models, Bank):
            bank = Bank([models] if isinstance(models, MotionModel) else models)
        T = _validate.array("times", times, (None, "T")).shape[-1]
        scans = Scans.checked(measurement, times, _values(present, T, measurement, pairs), pairs)
        states = _validate.array("trajectory", trajectory, (None, T, "c"))
        space = bank.space(measurement.dims)
        names = column_names("trajectory", states.shape[-1], space, components)
        try:
            np.broadcast_shapes(scans.batch, states.shape[:-2])
        except ValueError:
            raise ValueError(
                f"trajectory: batch axes {states.shape[:-2]} do not fit those of times and "
                f"present, {scans.batch}"
            ) from None
        course = cls(
            bank=bank,
            scans=scans,
            sequence=_sequence(modes, bank, T),
            states=states,
            names=names,
            axes=_axes(axis, states.ndim - 2),
        )
        for j in set(course.sequence):
            lacking = [c for c in space.modes[j] if c not in names]
            if lacking and not isinstance(bank.models[j], LinearMotion):
                raise ValueError(
                    f"trajectory: {bank.names[j]} is not linear and needs all of its components, "
                    f"{', '.join(space.modes[j])}; lacking: {', '.join(lacking)}"
                )
        return course

    @property
    def space(self) -> StateSpace:
        """How the modes' states fit together."""
        return self.bank.space(self.scans.measurement.dims)

    @property
    def batch(self) -> tuple[int, ...]:
        """Batch axes of all that varies."""
        return np.broadcast_shapes(self.scans.batch, self.states.shape[:-2])

    def columns(self, wanted: Sequence[str]) -> Array:
        """Return the true states in these components (..., T, n), zero where not given."""
        result = np.zeros((*self.states.shape[:-1], len(wanted)))
        for i, name in enumerate(wanted):
            if name in self.names:
                result[..., i] = self.states[..., self.names.index(name)]
        return result

    def times(self) -> Array:
        """Return the times (T,) or (..., T), without the axes that are averaged over.

        Raises
        ------
        ValueError
            Times that vary along these axes.
        """
        times = self.scans.times
        if times.ndim == 1 or not self.axes:
            return times
        times = np.broadcast_to(times, (*self.batch, times.shape[-1]))
        axes = tuple(a - 1 for a in self.axes)
        if np.any(np.ptp(times, axis=axes)):
            raise ValueError("times: expected the same along the axes that are averaged over")
        result: Array = np.min(times, axis=axes)
        return result

    def information(self) -> Array:
        """Return what each scan says about position and velocity (..., T, 2d, 2d), averaged.

        Raises
        ------
        ValueError
            Velocities are measured, and the trajectory has none.
        """
        d = self.space.dims
        kinematic = component_names(d, 1)
        x = self.columns(kinematic)
        J = fisher_information(
            self.scans.together(),
            x[..., :d],
            x[..., d:],
            self.scans.times,
            np.isfinite(self.scans.values),
        )
        if not set(kinematic) <= set(self.names) and np.any(J[..., d:, d:]):
            raise ValueError(
                f"trajectory: velocities are measured, so {', '.join(kinematic[d:])} are needed "
                f"beside the position; got {', '.join(self.names)}"
            )
        return self.averaged(J, 3)

    def averaged(self, values: Array, trailing: int) -> Array:
        """Return the mean of `values`, of so many trailing axes, over the axes to average over."""
        if not self.axes:
            return values
        full = np.broadcast_to(values, (*self.batch, *values.shape[values.ndim - trailing :]))
        result: Array = np.mean(full, axis=tuple(a - trailing for a in self.axes))
        return result


def column_names(
    name: str, count: int, space: StateSpace, given: Sequence[str] | None
) -> tuple[str, ...]:
    """Return what the `count` components of the argument `name` are called."""
    d = space.dims
    choices = [space.components, *(component_names(d, order) for order in range(3))]
    if given is not None:
        if isinstance(given, str) or len(set(given)) != len(given):
            raise ValueError(f"components: expected different names, got {given!r}")
        choices.insert(0, tuple(given))
    for choice in choices:
        if len(choice) == count:
            if not set(component_names(d, 0)) <= set(choice):
                raise ValueError(
                    f"components: expected the position {', '.join(component_names(d, 0))} "
                    f"among them, got {', '.join(choice)}"
                )
            return choice
    each = dict.fromkeys(f"{len(c)} ({', '.join(c)})" for c in choices)
    raise ValueError(f"{name}: expected {' or '.join(each)} components, got {count}")


def _values(present: Any, T: int, measurement: MeasurementModel, pairs: Any) -> Array:
    m = measurement.size if pairs is None or np.ndim(pairs) < 3 else np.shape(pairs)[-2]
    if present is None:
        return np.zeros((T, m))
    try:
        rows = np.asarray(present)
    except ValueError as error:
        raise ValueError(f"present: expected an array ({T}, {m}), got {present!r}") from error
    if rows.dtype.kind in "iu":
        raise ValueError("present: expected booleans, or values with NaN for missing, got integers")
    if rows.dtype.kind == "b":
        rows = np.where(rows, 0.0, np.nan)
    return _validate.array("present", rows, (None, T, m), finite=False)


def _sequence(modes: Sequence[int | str] | None, bank: Bank, T: int) -> tuple[int, ...]:
    if modes is None:
        if len(bank) > 1:
            raise ValueError(
                f"modes: with {len(bank)} models, say which is in force over the step that ends "
                f"at each of the {T} times"
            )
        return (0,) * T
    if isinstance(modes, str) or not isinstance(modes, Iterable):
        raise ValueError(f"modes: expected {T} indices or names, got {modes!r}")
    every = list(modes)
    if len(every) != T:
        raise ValueError(f"modes: expected one for each of the {T} times, got {len(every)}")
    return tuple(_mode(k, mode, bank) for k, mode in enumerate(every))


def _mode(k: int, mode: Any, bank: Bank) -> int:
    if isinstance(mode, str) and mode in bank.names:
        return bank.names.index(mode)
    whole = isinstance(mode, int | np.integer) and not isinstance(mode, bool)
    if whole and 0 <= mode < len(bank):
        return int(mode)
    raise ValueError(
        f"modes: modes[{k}] is {mode!r}, expected an index below {len(bank)} or one of "
        f"{', '.join(bank.names)}"
    )


def _axes(axis: int | tuple[int, ...] | None, ndim: int) -> tuple[int, ...]:
    if axis is None:
        return ()
    axes = axis if isinstance(axis, tuple) else (axis,)
    fits = all(isinstance(a, int | np.integer) and -ndim <= a < ndim for a in axes)
    counted = {a % ndim - ndim for a in axes} if fits else set()
    if not axes or not fits or len(counted) != len(axes):
        raise ValueError(
            f"axis: expected some of the {ndim} batch axes of the trajectory, got {axis!r}"
        )
    return tuple(sorted(counted))
