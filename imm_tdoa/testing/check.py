"""The public checks: every law tried on a model, every broken one told."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

from hypothesis.strategies import SearchStrategy

from imm_tdoa import _validate, registry
from imm_tdoa.testing import measurement_information as information
from imm_tdoa.testing import measurement_noise as noise
from imm_tdoa.testing import measurement_structure as structure
from imm_tdoa.testing import measurement_symmetry as symmetry
from imm_tdoa.testing import motion_dynamics, motion_noise, motion_structure, strategies
from imm_tdoa.testing.examine import broken
from imm_tdoa.testing.examine import verdicts as _verdicts
from imm_tdoa.testing.laws import BrokenLaw, Law, Verdict

_MOTION = (
    motion_structure.interface,
    motion_structure.components,
    motion_structure.shapes,
    motion_structure.batch,
    motion_structure.pure,
    motion_dynamics.identity,
    motion_dynamics.semigroup,
    motion_dynamics.kinematics,
    motion_dynamics.jacobian,
    motion_dynamics.linear,
    motion_dynamics.translation,
    motion_dynamics.rotation,
    motion_noise.noise_covariance,
    motion_noise.noise_at_once,
    motion_noise.noise_grows,
    motion_noise.noise_reaches_position,
    motion_noise.noise_composes,
    motion_noise.isotropy,
    motion_structure.refusal,
)
_MEASUREMENT = (
    structure.interface,
    structure.shapes,
    structure.batch,
    structure.pure,
    noise.position_jacobian,
    noise.velocity_jacobian,
    noise.noise_covariance,
    noise.error_sources,
    noise.noise_definite,
    noise.independent_rows,
    symmetry.translation,
    symmetry.rotation,
    symmetry.units,
    information.reference,
    information.reference_free,
    structure.pairs,
    structure.refusal,
)


def motion_laws() -> tuple[Law, ...]:
    """Return the laws of motion models, in the order they are tried."""
    return _MOTION


def measurement_laws() -> tuple[Law, ...]:
    """Return the laws of measurement models, in the order they are tried."""
    return _MEASUREMENT


def check_motion_model(
    model: Any,
    dims: Sequence[int] = (1, 2, 3),
    *,
    examples: int = 50,
    without: Sequence[str] = (),
) -> None:
    """Check that a motion model obeys the laws every motion model must (ALGORITHMS §2, §14.3).

    Parameters
    ----------
    model : MotionModel
        An instance, ``Mine(psd=1.0)``. A model whose noise is not meant to compose over time
        steps (piecewise constant noise) says so by an attribute ``composes = False``.
    dims : sequence of int
        Space dimensions to try, of 1, 2 and 3. Those that ``components(dims)`` refuses with a
        ValueError are left out; one at least must remain.
    examples : int
        How many examples each law is tried on. They are the same in every run.
    without : sequence of str
        Names of laws (`motion_laws`) the model is not meant to obey, e.g. ``"translation"`` for
        one that is drawn home.

    Raises
    ------
    AssertionError
        Laws are broken: which, with their equations, and the simplest values found for which
        each fails, and by how much.
    ValueError
        `model` is a class or function, or another argument is wrong.

    Examples
    --------
    >>> from imm_tdoa.models import ConstantVelocity
    >>> check_motion_model(ConstantVelocity(psd=1.0))
    """
    _raise(model, "motion", motion_verdicts(model, dims, examples=examples, without=without))


def check_measurement_model(
    model: Any,
    *,
    kinematics: SearchStrategy[strategies.Kinematics] | None = None,
    bad_arguments: Sequence[Callable[[], Any]] = (),
    examples: int = 50,
    without: Sequence[str] = (),
) -> None:
    """Check that a measurement model obeys the laws every measurement model must (§1, §14.3).

    Parameters
    ----------
    model : MeasurementModel
        An instance, ``Mine(stations, sigma=1.0)``.
    kinematics : hypothesis strategy of Kinematics, optional
        Emitters to try it on; default `strategies.kinematics(model)`: all around its stations.
    bad_arguments : sequence of callables
        Calls that must raise ValueError, e.g. ``lambda: Mine(stations, sigma=-1.0)``.
    examples : int
        How many examples each law is tried on. They are the same in every run.
    without : sequence of str
        Names of laws (`measurement_laws`) the model is not meant to obey.

    Raises
    ------
    AssertionError
        Laws are broken: which, with their equations, and the simplest values found for which
        each fails, and by how much.
    ValueError
        `model` is a class or function, or another argument is wrong.
    """
    found = measurement_verdicts(
        model,
        kinematics=kinematics,
        bad_arguments=bad_arguments,
        examples=examples,
        without=without,
    )
    _raise(model, "measurement", found)


def broken_laws(model: Any, *, examples: int = 50) -> list[BrokenLaw]:
    """Return the laws that a motion or measurement model breaks, none if it is sound.

    Parameters
    ----------
    model, examples
        As for `verdicts`.
    """
    return broken(verdicts(model, examples=examples))


def verdicts(model: Any, *, examples: int = 50) -> list[Verdict]:
    """Return what became of each law for a motion or measurement model, exemptions included.

    Parameters
    ----------
    model : MotionModel or MeasurementModel
        An instance.
    examples : int
        How many examples each law is tried on.

    Raises
    ------
    ValueError
        `model` is a class or function, or neither kind of model.
    """
    _instance(model)
    if registry.kind_of(model) == "motion":
        return motion_verdicts(model, examples=examples)
    return measurement_verdicts(model, examples=examples)


def motion_verdicts(
    model: Any,
    dims: Sequence[int] = (1, 2, 3),
    *,
    examples: int = 50,
    without: Sequence[str] = (),
) -> list[Verdict]:
    """Return what `check_motion_model` finds, law by law."""
    _instance(model)
    if not len(dims):
        raise ValueError("dims: expected some of 1, 2 and 3, got none")
    subject = motion_structure.motion(model, tuple(_validate.dimensions(d) for d in dims))
    return _verdicts(_MOTION, subject, examples=examples, without=without)


def measurement_verdicts(
    model: Any,
    *,
    kinematics: SearchStrategy[strategies.Kinematics] | None = None,
    bad_arguments: Sequence[Callable[[], Any]] = (),
    examples: int = 50,
    without: Sequence[str] = (),
) -> list[Verdict]:
    """Return what `check_measurement_model` finds, law by law."""
    _instance(model)
    places = strategies.kinematics(model) if kinematics is None else kinematics
    subject = structure.Measured(model, places, tuple(bad_arguments))
    return _verdicts(_MEASUREMENT, subject, examples=examples, without=without)


def _instance(model: Any) -> None:
    if inspect.isclass(model):
        raise ValueError(
            f"model: expected an instance, got the class {model.__name__}; "
            f"make one, {model.__name__}(...), and check that"
        )
    if inspect.isroutine(model):
        raise ValueError(f"model: expected a model, got the function {model.__name__}")


def _raise(model: Any, kind: str, found: Sequence[Verdict]) -> None:
    laws = broken(found)
    if not laws:
        return
    untried = sum(v.outcome == "not tried" for v in found)
    text = repr(model)
    lines = [
        f"{text if len(text) <= 100 else type(model).__name__} breaks {len(laws)} of the "
        f"{len(found)} laws of {kind} models"
        + (f" ({untried} could not be tried)" if untried else "")
        + ":",
        *(str(one) for one in laws),
    ]
    raise AssertionError("\n".join(lines))
