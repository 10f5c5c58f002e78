"""Running estimators on the three targets, all runs in one batch."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import locate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array
from imm_tdoa.imm import IMM
from imm_tdoa.locate.fix import Fix
from imm_tdoa.reproduce.motion_form import faithful, scenario
from imm_tdoa.reproduce.motion_form.scenario import MODELS, Motion
from imm_tdoa.reproduce.motion_form.switches import Switches


@attrs.frozen(eq=False)
class Data:
    """What was measured of three targets, and the fixes that every estimator starts from.

    Attributes
    ----------
    motion : Motion
        How they move.
    values : (runs, 3, T, 3)
        Time differences, s.
    first : Fix
        Fixes (runs, 3) from the first epoch.
    switches : Switches
        What the estimators take as printed.
    """

    motion: Motion
    values: Array
    first: Fix
    switches: Switches

    @classmethod
    def drawn(cls, seed: int, runs: int, motion: Motion, switches: Switches) -> Data:
        """Draw the noise of `runs` runs from `seed`."""
        values = scenario.draw(seed, scenario.check_runs(runs), motion, switches)
        return cls(motion, values, fixes(values[..., 0, :], switches), switches)


def fixes(values: Array, switches: Switches) -> Fix:
    """Locate from each epoch (..., 3) alone: the paper's (3) to (9), sign and weights right."""
    kind, sigma = scenario.noise_level(scenario.full(switches))
    if kind == "toa_sigma":
        return locate.gauss_newton(scenario.stations(), values, toa_sigma=sigma)
    return locate.gauss_newton(scenario.stations(), values, tdoa_sigma=sigma)


def first_state(position: Array, covariance: Array, model: str) -> tuple[Array, Array]:
    """Return mean and covariance of a model's first state: a fix, and the rest unknown."""
    kinds = ("velocity", "acceleration")[: MODELS.index(model)]
    std = np.repeat([0.0, *(scenario.BIRTH_STD[kind] for kind in kinds)], 2)
    n = len(std)
    x = np.zeros((*position.shape[:-1], n))
    P = np.zeros((*covariance.shape[:-2], n, n))
    x[..., :2], P[..., :2, :2] = position, covariance
    return x, P + np.diag(std**2)


def bank_positions(bank: Bank, data: Data) -> tuple[Array, Array]:
    """Track by the library's IMM.

    Returns
    -------
    positions : (runs, 3, T, 2)
        Those of the fix and of every epoch after it, m.
    mode_probability : (runs, 3, T - 1, r)
        After every epoch but the first.
    """
    imm, first = IMM(bank, scenario.measurement(data.switches)), data.first
    times = data.motion.times
    start = imm.start(times[0], first.position, first.covariance)
    track = imm.run(times[1:], data.values[..., 1:, :], start)
    positions = np.concatenate([first.position[..., None, :], track.position], axis=-2)
    return positions, track.mode_probability


def model_positions(model: str, data: Data, process_noise: float, sign: float = 1.0) -> Array:
    """Return positions (runs, 3, T, 2) of one motion model's filter, m.

    The library's filter, unless a switch asks for what it refuses.
    """
    motion_model = scenario.motion_model(model, process_noise)
    if sign == 1.0 and data.switches.jacobian == "zeros":
        bank = Bank([motion_model], birth_std=scenario.BIRTH_STD)
        return bank_positions(bank, data)[0]
    return faithful.extended_kalman(
        scenario.measurement(data.switches),
        motion_model,
        data.motion.times,
        data.values,
        *first_state(data.first.position, data.first.covariance, model),
        columns=data.switches.jacobian,
        sign=sign,
    )
