"""Several measurements of the same scan, one after another."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.makeup import Makeup, joined
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement, receiver_covariance


@attrs.frozen(eq=False, init=False)
class Stack:
    """The rows of several measurement models, concatenated.

    ``Stack(TDOA(...), FDOA(...))``. The models' noises are independent, but for receiver errors:
    models of the same `Stations` object share them, and the cross-covariance is in R. A stack
    among the models counts as its members.

    Parameters
    ----------
    *models : MeasurementModel
        At least one; all of the same number of space dimensions.
    """

    models: tuple[MeasurementModel, ...]

    def __init__(self, *models: MeasurementModel) -> None:
        if not models:
            raise ValueError("Stack: expected at least one measurement model, got none")
        for i, model in enumerate(models):
            if not isinstance(model, MeasurementModel):
                raise ValueError(f"Stack: argument {i} is no measurement model: {model!r}")
            if model.dims != models[0].dims:
                raise ValueError(
                    f"Stack: models of {models[0].dims} and {model.dims} dimensions do not go "
                    f"together"
                )
        flat = [part for model in models for part in getattr(model, "models", (model,))]
        object.__setattr__(self, "models", tuple(flat))

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return self.models[0].dims

    @property
    def size(self) -> int:
        """Number of rows m of all models."""
        return sum(model.size for model in self.models)

    @property
    def scale(self) -> Array:
        """Factors (m,) from the caller's units to internal units."""
        return np.concatenate([model.scale for model in self.models])

    @property
    def angular(self) -> Mask:
        """Which rows (m,) are angles."""
        return np.concatenate([model.angular for model in self.models])

    @property
    def offset_group(self) -> Index:
        """Offset groups (m,) of the models, kept apart from each other."""
        groups, used = [], 0
        for model in self.models:
            group = model.offset_group
            groups.append(np.where(group >= 0, group + used, -1))
            used += int(group.max(initial=-1)) + 1
        return np.concatenate(groups)

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the rows (..., m) of all models."""
        return np.concatenate(
            _same_batch([m.predict(position, velocity, time) for m in self.models], 1), axis=-1
        )

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the Jacobians (..., m, d) of all models."""
        parts = [m.jacobian(position, velocity, time) for m in self.models]
        Hp = np.concatenate(_same_batch([p for p, _ in parts], 2), axis=-2)
        return Hp, np.concatenate(_same_batch([v for _, v in parts], 2), axis=-2)

    def makeup(self) -> Makeup | None:
        """Return what the rows of all models are made of, where each model says so."""
        says = [getattr(model, "makeup", None) for model in self.models]
        return joined([None if say is None else say() for say in says])

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return R (..., m, m): block diagonal, but for receiver errors that models share."""
        blocks = _same_batch([m.noise_covariance(position, velocity, time) for m in self.models], 2)
        ends = np.cumsum([0, *(model.size for model in self.models)])
        rows = [slice(a, b) for a, b in pairwise(ends)]
        R = np.zeros((*blocks[0].shape[:-2], ends[-1], ends[-1]))
        for here, block in zip(rows, blocks, strict=True):
            R[..., here, here] = block
        shared = [
            (here, model, model.station_jacobian(position, velocity, time))
            for here, model in zip(rows, self.models, strict=True)
            if isinstance(model, ReceiverMeasurement) and model.uncertain
        ]
        for a, (here, left, J) in enumerate(shared):
            for there, right, K in shared[a + 1 :]:
                if left.stations is right.stations:
                    C = receiver_covariance(left.stations, J, K)
                    R[..., here, there] = C
                    R[..., there, here] = np.swapaxes(C, -1, -2)
        return R

    def error_sources(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the models' sources of error, block by block."""
        parts = [m.error_sources(position, velocity, time) for m in self.models]
        blocks = _same_batch([D for D, _ in parts], 2)
        D = np.zeros((*blocks[0].shape[:-2], self.size, sum(b.shape[-1] for b in blocks)))
        row = column = 0
        for block in blocks:
            m, k = block.shape[-2:]
            D[..., row : row + m, column : column + k] = block
            row, column = row + m, column + k
        return D, np.concatenate(_same_batch([v for _, v in parts], 1), axis=-1)

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the rows each model calls redundant."""
        ends = np.cumsum([model.size for model in self.models])[:-1]
        parts = np.split(present, ends, axis=-1)
        kept = [model.independent(p) for model, p in zip(self.models, parts, strict=True)]
        return np.concatenate(kept, axis=-1)

    def anchors(self, time: float | Array, present: Mask) -> Array:
        """Return the stations (..., k, d) behind each model's `present` rows."""
        ends = np.cumsum([model.size for model in self.models])[:-1]
        parts = np.split(present, ends, axis=-1)
        where = [m.anchors(time, p) for m, p in zip(self.models, parts, strict=True)]
        return np.concatenate(_same_batch(where, 2), axis=-2)

    def with_pairs(self, pairs: Any) -> Stack:
        """Return the stack for other pairs (..., m, 2), those of its pair models in order.

        Raises
        ------
        ValueError
            Not as many pairs as its pair models have.
        """
        pairs = np.asarray(pairs)
        models, start = [], 0
        for model in self.models:
            if not hasattr(model, "pairs"):
                models.append(model)
                continue
            models.append(model.with_pairs(pairs[..., start : start + model.size, :]))
            start += model.size
        if start != pairs.shape[-2]:
            raise ValueError(f"pairs: expected {start} pairs for this stack, got {pairs.shape[-2]}")
        return Stack(*models)


def _same_batch(arrays: list[Array], trailing: int) -> list[Array]:
    batch = np.broadcast_shapes(*(a.shape[: a.ndim - trailing] for a in arrays))
    return [np.broadcast_to(a, batch + a.shape[a.ndim - trailing :]) for a in arrays]
