"""How a fix answers to its rows, at a position, under the noise of a sequence filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.sequence_filter.loop_gain import Rule, loop_gain, pseudo_inverse

if TYPE_CHECKING:
    from imm_tdoa.sequence_filter.stage import SequenceFilter

TARGET = 0.5  # loop gain that an automatic multiplier aims at


class Response(NamedTuple):
    """Gradients G (..., m, d), what the fix makes of its rows (..., d, m), their correlation.

    Rows that are not present have no part in the fix and no correlation.
    """

    G: Array
    inverse: Array
    correlation: Array

    @classmethod
    def at(cls, stage: SequenceFilter, p: Array, time: float | Array, present: Mask) -> Response:
        """Return the response at positions p (..., d) where rows (..., m) are `present`."""
        rest = np.zeros_like(p)
        G = stage.measurement.jacobian(p, rest, time)[0]
        heard = np.asarray(np.isfinite(G).all(axis=-1))
        G = np.where(heard[..., None], G, 0.0)
        R = exact(stage.measurement).noise_covariance(p, rest, time)
        use = np.asarray(present & heard & np.isfinite(np.einsum("...ii->...i", R)))
        both = use[..., :, None] & use[..., None, :]
        scale = np.sqrt(np.where(use, np.einsum("...ii->...i", R), 1.0))
        correlation = np.where(both, R / (scale[..., :, None] * scale[..., None, :]), 0.0)
        weight = weighing(stage).noise_covariance(p, rest, time)
        return cls(G, pseudo_inverse(G, weight, use), correlation)

    def loop_gain(self, rule: Rule) -> Array:
        """Return kappa (...) at multiplier 1."""
        return loop_gain(rule, self.G, self.inverse, self.correlation)

    def covariance(self, variance: Array) -> Array:
        """Return the covariance (..., d, d) of a fix from rows of `variance` (..., m)."""
        own = self.inverse * np.sqrt(variance)[..., None, :]
        result: Array = np.einsum("...dm,...mn,...en->...de", own, self.correlation, own)
        return result


def exact(model: MeasurementModel) -> MeasurementModel:
    """Return the model of the differences as if receivers were exactly where they say.

    Receiver errors last: averaging over time does not help against them.
    """
    some: Any = model
    if not some.uncertain:
        return model
    bare = attrs.evolve(some.stations, position_covariance=None, velocity_covariance=None)
    result: MeasurementModel = attrs.evolve(some, stations=bare)
    return result


def weighing(stage: SequenceFilter) -> MeasurementModel:
    """Return the model whose R weighs the rows of the fix."""
    model: Any = stage.measurement
    if stage.weights == "full" or model.toa_sigma is None:
        return stage.measurement
    sigma = model.toa_sigma
    sigma = np.broadcast_to(sigma, (*sigma.shape[:-1], len(stage.stations)))
    each = np.hypot(sigma[..., :-1], sigma[..., 1:])
    result: MeasurementModel = attrs.evolve(model, toa_sigma=None, tdoa_sigma=each)
    return result


def multiplier(stage: SequenceFilter, once: Array) -> Array:
    """Return the factor (...) on the process noise where kappa is `once` at factor 1."""
    if stage.multiplier == "auto":
        usable = np.isfinite(once) & (once > 0.0)
        return np.where(usable, TARGET / np.where(usable, once, 1.0), np.nan)
    return np.broadcast_to(np.float64(stage.multiplier), once.shape)
