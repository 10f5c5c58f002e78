"""Targets that stand, set off and accelerate: an IMM against any single filter (§5.4)."""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.motion_form import expected, scenario, tracking
from imm_tdoa.reproduce.motion_form.interacting import RULES
from imm_tdoa.reproduce.motion_form.sample import Sample
from imm_tdoa.reproduce.motion_form.scenario import MODELS, SWITCHING
from imm_tdoa.reproduce.motion_form.switches import Mixing, Switches
from imm_tdoa.reproduce.motion_form.tracking import Data

STAY = 0.99
# Decades of process noise that are swept, each with its model's minimum well inside.
DECADES = {
    "static": (-1, 2),  # km²/s
    "constant-velocity": (-4, 1),  # km²/s³
    "constant-acceleration": (-6, -1),  # km²/s⁵
}
PER_DECADE = 3


@attrs.frozen(eq=False)
class Switching:
    """IMMs on the switching targets.

    Attributes
    ----------
    imms : dict of mixing rule to Sample
        Errors under each rule.
    mode_probability : dict of mixing rule to (K, 3)
        Mean over runs and targets, after each epoch but the first.
    bound_km : (K,)
        Mean error at the posterior Cramér-Rao bound of an estimator told all that happens.
    estimate : (3, K + 1, 2)
        Positions of the first run under the rule chosen by the switches, m.
    """

    imms: dict[Mixing, Sample]
    mode_probability: dict[Mixing, Array]
    bound_km: Array
    estimate: Array


@attrs.frozen(eq=False)
class Single:
    """One motion model with one process noise, km² s^-1, s^-3 or s^-5, on the switching targets."""

    model: str
    process_noise: float
    sample: Sample


@attrs.frozen(eq=False)
class Sweep:
    """Every single filter that was tried.

    Attributes
    ----------
    singles : tuple of Single
        Model by model, in the order of their noise.
    """

    singles: tuple[Single, ...]

    @property
    def best(self) -> Single:
        """The one with the least mean error."""
        return min(self.singles, key=lambda single: single.sample.mean_km)

    def of_model(self, model: str) -> tuple[Single, ...]:
        """Those of one motion model, in the order of their noise."""
        return tuple(single for single in self.singles if single.model == model)


def switching(
    runs: int = 100,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Switching:
    """Run the IMM under three mixing rules on targets that switch.

    15 steps standing, 15 at constant velocity, 15 at constant acceleration; a mode stays with
    probability 0.99 a step. The rest is as in `interacting.rivals`.

    Parameters
    ----------
    runs, seed, switches, tell
        As for `interacting.rivals`.
    """
    data = _data(runs, seed, switches)
    switches = data.switches
    transition = np.full((3, 3), 0.5 * (1.0 - STAY)) + (1.5 * STAY - 0.5) * np.eye(3)
    imms, found, estimate = {}, {}, np.empty(0)
    for rule in RULES:
        tell(f"switching targets, {rule} mixing")
        bank = scenario.all_models(switches.process_noise, mixing=rule, transition=transition)
        positions, probability = tracking.bank_positions(bank, data)
        imms[rule] = Sample.of(positions, SWITCHING.truth())
        found[rule] = probability.mean(axis=(0, 1))
        if rule == switches.mixing:
            estimate = positions[0]
    bound = expected.bound_of_filter(SWITCHING, switches).mean(axis=0)
    return Switching(imms, found, bound, estimate)


def sweep(
    runs: int = 100,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
    per_decade: int = PER_DECADE,
) -> Sweep:
    """Run every single filter on the switching targets, on the noise that `switching` has.

    Parameters
    ----------
    runs, seed, switches, tell
        As for `interacting.rivals`; here every filter has the process noise of the sweep.
    per_decade : int
        Noise levels per factor of ten, besides none at all.
    """
    data = _data(runs, seed, switches)
    truth, singles = SWITCHING.truth(), []
    for model in MODELS:
        for density in levels(model, per_decade):
            tell(f"single filters, {model}")
            positions = tracking.model_positions(model, data, density)
            singles.append(Single(model, density, Sample.of(positions, truth)))
    return Sweep(tuple(singles))


def levels(model: str, per_decade: int = PER_DECADE) -> list[float]:
    """Return the process noises that are tried: none, and some per decade, km² s^-1, -3, -5."""
    low, high = DECADES[model]
    return [0.0, *(float(q) for q in np.logspace(low, high, (high - low) * per_decade + 1))]


def _data(runs: int, seed: int, switches: Switches | None) -> Data:
    chosen = Switches() if switches is None else switches
    right = attrs.evolve(chosen, jacobian="zeros", tdoa_sign="slave-master")
    return Data.drawn(seed, runs, SWITCHING, right)
