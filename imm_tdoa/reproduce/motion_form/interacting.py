"""One IMM instead of the choice between three filters (ALGORITHMS §5.4)."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import attrs

from imm_tdoa.reproduce.motion_form import scenario, tracking
from imm_tdoa.reproduce.motion_form.sample import Sample
from imm_tdoa.reproduce.motion_form.scenario import MODELS, MOTIONS
from imm_tdoa.reproduce.motion_form.switches import Mixing, Switches
from imm_tdoa.reproduce.motion_form.tracking import Data

SOJOURN_S = 60.0
RULES: tuple[Mixing, ...] = get_args(Mixing)


@attrs.frozen(eq=False)
class Rivals:
    """All estimators on targets that move in one way, on the same noise.

    Attributes
    ----------
    motion : str
        How the targets move; also the name of the model that matches.
    singles : dict of model to Sample
        Each motion model's own filter.
    imms : dict of mixing rule to Sample
        The IMM of all three models, never told the motion.
    true_mode_probability : dict of mixing rule to float
        What the IMM gives the true mode at the last epoch, mean over runs and targets.
    """

    motion: str
    singles: dict[str, Sample]
    imms: dict[Mixing, Sample]
    true_mode_probability: dict[Mixing, float]

    @property
    def matched(self) -> Sample:
        """The filter that was told the motion."""
        return self.singles[self.motion]

    def cost(self, mixing: Mixing) -> tuple[float, float]:
        """Mean error of an IMM over the matched filter's, and the ratio's standard error."""
        return self.imms[mixing].ratio(self.matched)


def rivals(
    runs: int = 100,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[Rivals, ...]:
    """Run three single filters and the IMM under three mixing rules on each kind of motion.

    The generator of the chain has a mean sojourn of 60 s (0.9675 to stay over 2 s), modes start
    equally likely, and the birth law is what the single filters too believe at the start: 5 km/s
    and 0.5 km/s². The noise is Table 1's.

    Parameters
    ----------
    runs, seed, switches
        As for `table.table`; the sign and the Jacobian do not concern the library's filters.
    tell : callable
        Is told what comes next, once for each motion.
    """
    switches = Switches() if switches is None else switches
    right = attrs.evolve(switches, jacobian="zeros", tdoa_sign="slave-master")
    result = []
    for motion in MOTIONS:
        tell(f"IMM on {motion.name} targets")
        data, truth = Data.drawn(seed, runs, motion, right), motion.truth()
        singles = {
            name: Sample.of(tracking.model_positions(name, data, right.process_noise), truth)
            for name in MODELS
        }
        imms, found = {}, {}
        for rule in RULES:
            bank = scenario.all_models(right.process_noise, mixing=rule, mean_sojourn=SOJOURN_S)
            positions, probability = tracking.bank_positions(bank, data)
            imms[rule] = Sample.of(positions, truth)
            found[rule] = float(probability[..., -1, MODELS.index(motion.name)].mean())
        result.append(Rivals(motion.name, singles, imms, found))
    return tuple(result)
