"""Where targets truly go, all runs of a chunk at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index, component_names
from imm_tdoa.simulate import Leg, Target, trajectory
from imm_tdoa.statespace import lift


class Form(NamedTuple):
    """A motion: what it is called, and the registered name of its model."""

    name: str
    model: str


class Ways(NamedTuple):
    """The true ways of n runs.

    Attributes
    ----------
    state : (n, T, c)
        Position, velocity and whatever else the motions have, by `components`.
    components : tuple of c str
        Names of the columns, positions first, then velocities.
    forms : tuple of Form
        The motions that there are.
    form : (n, T) int
        Which of them was in force over the step that ends at each scan.
    since : (n, T)
        When it began, s.
    """

    state: Array
    components: tuple[str, ...]
    forms: tuple[Form, ...]
    form: Index
    since: Array

    @property
    def dims(self) -> int:
        """Number of space dimensions."""
        return sum(name in ("x", "y", "z") for name in self.components)

    @property
    def position(self) -> Array:
        """Positions (n, T, d), m."""
        return self.state[..., : self.dims]

    @property
    def velocity(self) -> Array:
        """Velocities (n, T, d), m/s."""
        return self.state[..., self.dims : 2 * self.dims]


def by_legs(targets: Sequence[Target], runs: Index, times: Array, unit: Array) -> Ways:
    """Return the ways of targets that follow their legs; run i takes target i, counted round.

    Parameters
    ----------
    targets : sequence of Target
        All over the same time.
    runs : (n,) int
        Numbers of the runs.
    times : (n, T)
        Times of the scans, s.
    unit : (n, T + L, 2, d)
        Standard normal numbers for legs with white acceleration, L the number of legs; may be
        empty, (n, 0, 2, d), where none has.
    """
    n, T = times.shape
    d = targets[0].dims
    forms = tuple(dict.fromkeys(form_of(leg) for target in targets for leg in _moving(target)))
    names = (*component_names(d, 2), "omega")
    state = np.empty((n, T, len(names)))
    form, since = np.empty((n, T), dtype=np.int64), np.empty((n, T))
    for k, target in enumerate(targets):
        mine = runs % len(targets) == k
        if not np.any(mine):
            continue
        still = attrs.evolve(
            target, legs=tuple(attrs.evolve(leg, acceleration_psd=0.0) for leg in target.legs)
        )
        here = np.clip(times[mine], target.start_s, target.end_s)
        same = bool(np.all(here == here[:1]))
        each = [trajectory(still, row) for row in (here[:1] if same else here)]
        parts = [np.stack([way[i] for way in each]) for i in range(3)]
        wander = _wander(target, here, unit[mine])
        state[mine, :, :d] = parts[0] + wander[..., 0, :]
        state[mine, :, d : 2 * d] = parts[1] + wander[..., 1, :]
        state[mine, :, 2 * d : 3 * d] = parts[2]
        form[mine], since[mine], rate = _in_force(target, forms, here)
        state[mine, :, 3 * d] = rate
    return Ways(state, names, forms, form, since)


def form_of(leg: Leg) -> Form:
    """Return the motion of a leg as a motion model knows it: without acceleration it is uniform."""
    model = {"turn": "coordinated-turn"}.get(leg.motion, leg.motion)
    if leg.acceleration_mps2 is not None and not any(leg.acceleration_mps2):
        model = "constant-velocity"
    if leg.motion == "turn" and not leg.turn_rate_dps:
        model = "constant-velocity"
    return Form(model, model)


def _moving(target: Target) -> tuple[Leg, ...]:
    """The legs, those at no speed at all as static ones."""
    speed = target.velocity_mps
    result = []
    for leg in target.legs:
        speed = leg.velocity_mps if leg.velocity_mps is not None else speed
        still = speed is None or not any(speed)
        if leg.motion == "static":
            speed = None
        elif leg.motion == "constant-acceleration" and form_of(leg).model != "constant-velocity":
            end = leg.end_velocity_mps
            speed = (1.0,) if end is None else end  # all that counts is whether it moves
        elif still and leg.acceleration_psd == 0.0:
            leg = Leg(motion="static", duration_s=leg.duration_s)
        result.append(leg)
    return tuple(result)


def _in_force(target: Target, forms: tuple[Form, ...], times: Array) -> tuple[Index, Array, Array]:
    """Which form held just before each time (n, T), since when, and the turn rate, rad/s."""
    legs = _moving(target)
    ends = target.start_s + np.cumsum([leg.duration_s for leg in legs])
    which = np.array([forms.index(form_of(leg)) for leg in legs])
    begins = np.concatenate([[target.start_s], ends[:-1]])
    for k in range(1, len(legs)):
        if which[k] == which[k - 1]:
            begins[k] = begins[k - 1]
    rates = np.radians([leg.turn_rate_dps or 0.0 for leg in legs])
    at = np.minimum(np.searchsorted(ends, times - 1e-9 * (1.0 + np.abs(times))), len(legs) - 1)
    return which[at], begins[at], rates[at]


def _wander(target: Target, times: Array, unit: Array) -> Array:
    """Position and velocity (n, T, 2, d) that the legs' white acceleration adds, exact.

    Over a step h it adds Cholesky factor of q [h³/3 h²/2; h²/2 h] times two unit numbers; a leg
    with a velocity of its own, and one that stands, forgets the velocity of before.
    """
    n, T = times.shape
    off = np.zeros((n, T, 2, target.dims))
    if not any(leg.acceleration_psd > 0.0 for leg in target.legs):
        return off
    place, speed = np.zeros((n, target.dims)), np.zeros((n, target.dims))
    borders = target.start_s + np.cumsum([leg.duration_s for leg in target.legs])
    now, used = np.full(n, target.start_s), 0
    done = np.zeros(n, dtype=np.int64)  # scans passed
    for k, leg in enumerate(target.legs):
        if leg.velocity_mps is not None or leg.motion == "static":
            speed = np.zeros_like(speed)
        last = k == len(target.legs) - 1
        inside = (times <= borders[k]) if last else (times < borders[k])
        until = inside.sum(axis=-1)
        for _ in range(int((until - done).max(initial=0))):
            ready = done < until
            at = np.minimum(done, T - 1)
            time = np.where(ready, times[np.arange(n), at], now)
            place, speed = _step(place, speed, time - now, leg.acceleration_psd, unit[:, used])
            off[np.flatnonzero(ready), at[ready], 0] = place[ready]
            off[np.flatnonzero(ready), at[ready], 1] = speed[ready]
            now, used, done = time, used + 1, done + ready
        if not last:
            h = borders[k] - now
            place, speed = _step(place, speed, h, leg.acceleration_psd, unit[:, used])
            now, used = np.full(n, borders[k]), used + 1
    return off


def _step(place: Array, speed: Array, h: Array, psd: float, unit: Array) -> tuple[Array, Array]:
    h = h[:, None]
    jolt = np.sqrt(psd * h) * unit[:, 0]
    shift = 0.5 * h * jolt + np.sqrt(psd * h**3 / 12.0) * unit[:, 1]
    return place + h * speed + shift, speed + jolt


def by_chance(
    bank: Bank, targets: Sequence[Target], runs: Index, times: Array, unit: Array, chance: Array
) -> Ways:
    """Return ways drawn from a bank: its chain, its process noise, its birth law.

    Parameters
    ----------
    bank : Bank
        The motions.
    targets : sequence of Target
        Where the ways begin: position, and velocity where one is given; run i takes target i,
        counted round.
    runs : (n,) int
        Numbers of the runs.
    times : (n, T)
        Times of the scans, s.
    unit : (n, T, 2, c)
        Standard normal numbers, c the number of all motions' components: births and noise.
    chance : (n, T)
        Uniform numbers: which motion.
    """
    d = targets[0].dims
    space = bank.space(d)
    union, r = space.components, len(bank)
    names = (*component_names(d, 1), *(c for c in union if c not in component_names(d, 1)))
    columns = [np.array([names.index(c) for c in mode]) for mode in space.modes]
    births = lift(union[:d], union, bank.birth_std).birth_variance
    birth_std = np.zeros(len(names))
    birth_std[[names.index(c) for c in union[d:]]] = np.sqrt(births)
    n, T = times.shape
    x, state = np.zeros((n, len(names))), np.empty((n, T, len(names)))
    begun = np.array([target.start_s for target in targets])[runs % len(targets)]
    mode = np.minimum((chance[:, 0, None] >= np.cumsum(bank.prior)).sum(axis=-1), r - 1)
    given = [target.velocity_mps for target in targets]
    places = [trajectory(target, target.start_s).position for target in targets]
    first = np.array(places)[runs % len(targets)]
    speed = np.array([v if v is not None else (np.nan,) * d for v in given])[runs % len(targets)]
    drawn = birth_std * _wide(unit[:, 0, 0], union, names)
    for j in range(r):
        mine = mode == j
        x[np.ix_(mine, columns[j])] = drawn[np.ix_(mine, columns[j])]
        if names[d] in space.modes[j]:
            x[mine, d : 2 * d] = np.where(np.isnan(speed[mine]), x[mine, d : 2 * d], speed[mine])
    x[:, :d] = first
    state[:, 0] = x
    form, since = np.empty((n, T), dtype=np.int64), np.empty((n, T))
    form[:, 0], since[:, 0] = mode, np.minimum(begun, times[:, 0])
    for k in range(1, T):
        dt = times[:, k] - times[:, k - 1]
        reach = np.cumsum(bank.chain(dt)[np.arange(n), mode], axis=-1)
        new = np.minimum((chance[:, k, None] >= reach).sum(axis=-1), r - 1)
        drawn = birth_std * _wide(unit[:, k, 0], union, names)
        noise = _wide(unit[:, k, 1], union, names)
        y = np.zeros_like(x)
        for j in range(r):
            for i in range(r):
                rows = np.flatnonzero((new == j) & (mode == i))
                if not len(rows):
                    continue
                fresh = [c for c in columns[j] if c not in columns[i]]
                before = x[rows]
                before[:, fresh] = drawn[np.ix_(rows, fresh)]
                own, step = before[:, columns[j]], dt[rows]
                moved = bank.models[j].propagate(own, step)
                root = _root(bank.models[j].process_noise(step, d))
                shake = (root @ noise[np.ix_(rows, columns[j])][..., None])[..., 0]
                y[np.ix_(rows, columns[j])] = moved + shake
        since[:, k] = np.where(new == mode, since[:, k - 1], times[:, k - 1])
        x, mode = y, new
        state[:, k], form[:, k] = x, mode
    forms = tuple(
        Form(name, registry.name_of(model))
        for name, model in zip(bank.names, bank.models, strict=True)
    )
    return Ways(state, names, forms, form, since)


def _wide(unit: Array, union: tuple[str, ...], names: tuple[str, ...]) -> Array:
    """Numbers (n, c) of the union's components under `names`, zero elsewhere."""
    result = np.zeros((len(unit), len(names)))
    result[:, [names.index(c) for c in union]] = unit
    return result


def _root(Q: Array) -> Array:
    """Return L (..., n, n) with L L' = Q, singular or not."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", Q), 0.0))
    unit = np.where(scale > 0.0, scale, 1.0)
    w, V = np.linalg.eigh(Q / (unit[..., :, None] * unit[..., None, :]))
    result: Array = unit[..., :, None] * V * np.sqrt(np.maximum(w, 0.0))[..., None, :]
    return result
