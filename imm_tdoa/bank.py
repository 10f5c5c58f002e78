"""A bank: motion models, how the emitter switches between them, and what a switch brings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa import _validate, registry
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, MotionModel
from imm_tdoa.statespace import KIND_OF, StateSpace, state_space

BIRTH_STD = {"velocity": 100.0, "acceleration": 10.0, "turn_rate": 0.3}
MIXING = ("birth", "unbiased", "zero")


def _models(models: Iterable[MotionModel]) -> tuple[MotionModel, ...]:
    if not isinstance(models, Iterable):
        raise ValueError(f"models: expected a sequence of motion models, got {models!r}")
    result = tuple(models)
    if not result:
        raise ValueError("models: expected at least one motion model, got none")
    for i, model in enumerate(result):
        if isinstance(model, type) or not isinstance(model, MotionModel):
            hint = "; pass an instance, not the class" if isinstance(model, type) else ""
            raise ValueError(f"models: models[{i}] is no motion model: {model!r}{hint}")
    return result


@attrs.frozen(eq=False)
class Bank:
    """Motion models with a Markov chain between them.

    Parameters
    ----------
    models : sequence of MotionModel
        The r modes.
    mean_sojourn : float or (r,), optional
        Mean time the emitter stays in a mode, s; on leaving, every other mode is as likely. The
        chain over a step is the exponential of the generator (ALGORITHMS §9.2), so it is right
        for any time steps. 60 s where neither this nor `transition` is given.
    transition : (r, r), optional
        Transition matrix applied once per scan, whatever the time step (not at dt = 0); entry
        ij is Pr(mode j now | mode i before), so its **rows** sum to one.
    prior : (r,), optional
        Mode probabilities at the start; default equal.
    mixing : "birth", "unbiased" or "zero"
        What fills the components a mode lacks when it is mixed into a bigger one (§9.3): the
        birth law; the bigger mode's own estimate (Yuan et al. 2012); zeros without variance.
    birth_std : mapping, optional
        Standard deviations of the birth law by kind (``velocity`` m/s, ``acceleration`` m/s²,
        ``turn_rate`` rad/s) or by component name; for a largest value e the moment match of a
        uniform law is e/sqrt(3). Default 100, 10 and 0.3.
    names : sequence of str, optional
        Mode names; default each model's registered name, numbered where it repeats.

    Raises
    ------
    ValueError
        No models, a class instead of an instance, rows that do not sum to one, a sojourn time
        that is not positive, both kinds of chain, an unknown mixing rule or birth key.
    """

    models: tuple[MotionModel, ...] = attrs.field(converter=_models)
    mean_sojourn: Any = attrs.field(default=None, kw_only=True)
    transition: Any = attrs.field(default=None, kw_only=True)
    prior: Any = attrs.field(default=None, kw_only=True)
    mixing: Literal["birth", "unbiased", "zero"] = attrs.field(default="birth", kw_only=True)
    birth_std: Mapping[str, float] = attrs.field(factory=dict, kw_only=True)
    names: tuple[str, ...] = attrs.field(default=(), kw_only=True)
    _spaces: dict[int, StateSpace] = attrs.field(init=False, factory=dict, repr=False)

    __repr__ = brief

    def __attrs_post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        r = len(self.models)
        if self.mean_sojourn is not None and self.transition is not None:
            raise ValueError("give mean_sojourn or transition, not both")
        if self.transition is not None:
            put("transition", _stochastic("transition", self.transition, (r, r)))
        else:
            sojourn = 60.0 if self.mean_sojourn is None else self.mean_sojourn
            put("mean_sojourn", _sojourn(sojourn, r))
        prior = np.full(r, 1.0 / r) if self.prior is None else self.prior
        put("prior", _stochastic("prior", prior, (r,)))
        if self.mixing not in MIXING:
            raise ValueError(f"mixing: expected one of {', '.join(MIXING)}, got {self.mixing!r}")
        put("birth_std", _birth(self.birth_std, self.models))
        put("names", _names(self.names, self.models))

    def __len__(self) -> int:
        return len(self.models)

    def space(self, dims: int) -> StateSpace:
        """Return how the modes' components fit together.

        Parameters
        ----------
        dims : int
            Number of space dimensions.
        """
        if dims not in self._spaces:
            self._spaces[dims] = state_space(self.models, self.names, dims, self.birth_std)
        return self._spaces[dims]

    def chain(self, dt: float | Array) -> Array:
        """Return the Markov chain between the modes over a time step (§9.2).

        Parameters
        ----------
        dt : float or (...)
            Time step, s. Nothing switches in no time; a fixed `transition` is applied once,
            however long the step.

        Returns
        -------
        (..., r, r)
            Pi, from row to column; rows sum to one.
        """
        dt = _validate.time_step(dt)
        r = len(self.models)
        if r == 1:
            return np.ones((*dt.shape, 1, 1))
        if self.transition is not None:
            return np.where(dt[..., None, None] > 0.0, self.transition, np.eye(r))
        return _exponential(self.generator(), dt)

    def generator(self) -> Array:
        """Return the generator (r, r), 1/s: rows sum to zero, leave rate 1/mean_sojourn.

        Raises
        ------
        ValueError
            The bank has a fixed transition matrix.
        """
        if self.mean_sojourn is None:
            raise ValueError("this bank has a fixed transition matrix and no generator")
        r = len(self.models)
        leave = 1.0 / self.mean_sojourn
        off = (np.ones((r, r)) - np.eye(r)) / max(r - 1, 1)
        result: Array = leave[:, None] * (off - np.eye(r))
        return result


def _exponential(generator: Array, dt: Array) -> Array:
    """Return exp(generator dt) (..., r, r) for every dt (...) s; no entry is ever negative.

    Uniformisation (Jensen 1953): with the largest leave rate q the generator is q (J - I), J
    stochastic, and the exponential a Poisson mixture of powers of J. A step of more than one
    expected jump is halved until it is short, and its matrix squared back.
    """
    eye = np.eye(len(generator))
    rate = -np.diag(generator).min()
    J = eye + generator / rate if rate > 0.0 else eye
    jumps = rate * dt[..., None, None]
    halvings = np.ceil(np.log2(np.maximum(jumps, 1.0)))
    jumps = jumps / 2.0**halvings
    weight, power = np.exp(-jumps), eye
    Pi = weight * power
    for k in range(1, 18):  # 1/18! is below rounding
        weight, power = weight * jumps / k, power @ J
        Pi = Pi + weight * power
    for h in range(int(np.max(halvings, initial=0.0))):
        Pi = np.where(h < halvings, Pi @ Pi, Pi)
        Pi = Pi / Pi.sum(axis=-1, keepdims=True)
    result: Array = Pi / Pi.sum(axis=-1, keepdims=True)
    return result


def _stochastic(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    matrix = _validate.array(name, value, shape)
    if np.any(matrix < 0.0):
        raise ValueError(f"{name}: expected probabilities, got {float(matrix.min()):g}")
    sums = np.atleast_1d(matrix.sum(axis=-1))
    if np.any(np.abs(sums - 1.0) > 1e-9):
        i = int(np.argmax(np.abs(sums - 1.0)))
        row = f"row {i} sums" if matrix.ndim == 2 else "they sum"
        columns = matrix.ndim == 2 and np.allclose(matrix.sum(axis=0), 1.0)
        hint = "; its columns do: is it transposed?" if columns else ""
        raise ValueError(f"{name}: expected rows that sum to 1, {row} to {sums[i]:.9g}{hint}")
    return matrix


def _sojourn(value: Any, r: int) -> Array:
    try:
        times = np.broadcast_to(np.asarray(value, dtype=float), (r,))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"mean_sojourn: expected one time or {r} of them, s, got {value!r}"
        ) from error
    if not np.all(times > 0.0):
        raise ValueError(f"mean_sojourn: expected times above 0 s, got {value!r}")
    return times


def _birth(given: object, models: tuple[MotionModel, ...]) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise ValueError(
            f"birth_std: expected a mapping of standard deviations by kind or component, "
            f"got {given!r}"
        )
    components: set[str] = set()
    for model in models:
        for dims in (1, 2, 3):
            with suppress(ValueError):  # a model need not exist in every number of dimensions
                components.update(model.components(dims))
    known = sorted(set(KIND_OF.values()) - {"position"})
    for key in given:
        if key not in known and key not in components:
            raise ValueError(
                f"birth_std: unknown key {key!r}; expected a kind ({', '.join(known)}) or a "
                f"component ({', '.join(sorted(components))})"
            )
    chosen = {key: _validate.non_negative(f"birth_std[{key!r}]", v) for key, v in given.items()}
    return {**BIRTH_STD, **chosen}


def _names(given: Iterable[str], models: tuple[MotionModel, ...]) -> tuple[str, ...]:
    names = tuple(given)
    if names:
        if len(names) != len(models) or len(set(names)) != len(names):
            raise ValueError(f"names: expected {len(models)} different names, got {names}")
        return names
    plain = [registry.name_of(model) for model in models]
    return tuple(
        name if plain.count(name) == 1 else f"{name}-{plain[: i + 1].count(name)}"
        for i, name in enumerate(plain)
    )
