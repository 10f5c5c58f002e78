"""What association works on: predicted rows, unlabelled rows, and who takes which.

A scan of several emitters is a list of measured rows of which nobody knows the emitter. Row i of
the measurement model (a station's difference to the reference) may have been measured several
times, once for each emitter heard and once for each false alarm, or not at all. All numbers are
in internal units (metres, radians), as in `imm_tdoa.observation`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import attrs
import numpy as np

from imm_tdoa import _validate, gaussian, mixture
from imm_tdoa.contract import Array, Index, Mask


def _mean(value: Any) -> Array:
    return _validate.array("mean", value, finite=False)


def _covariance(value: Any) -> Array:
    return _validate.array("covariance", value, finite=False)


def _values(value: Any) -> Array:
    return _validate.array("values", value, ("K",), finite=False)


def _row(value: Any) -> Index:
    return _integers("row", value)


@attrs.frozen(eq=False)
class Prediction:
    """What each target is expected to be measured as, in each mode of its bank.

    Parameters
    ----------
    mean : (N, m) or (N, r, m)
        Predicted rows of N targets, in each of r modes; NaN where a row cannot be measured.
    covariance : (N, m, m) or (N, r, m, m)
        Innovation covariances, H P H' + R.
    log_weight : (N, r), optional
        Logs of the predicted mode probabilities; needed with a mode axis.
    angular : (m,) bool, optional
        Rows that are angles, whose innovations are wrapped; default none.

    Raises
    ------
    ValueError
        Shapes that do not fit, infinite numbers, a variance that is not positive, weights that
        do not sum to one.
    """

    mean: Array = attrs.field(converter=_mean)
    covariance: Array = attrs.field(converter=_covariance)
    log_weight: Any = attrs.field(default=None, kw_only=True)
    angular: Any = attrs.field(default=None, kw_only=True)
    known: Mask = attrs.field(init=False, repr=False)

    def __attrs_post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        mean, S = self.mean, self.covariance
        if mean.ndim not in (2, 3):
            raise ValueError(f"mean: expected shape (N, m) or (N, r, m), got {mean.shape}")
        if S.shape != (*mean.shape, mean.shape[-1]):
            raise ValueError(
                f"covariance: expected shape {(*mean.shape, mean.shape[-1])}, got {S.shape}"
            )
        if mean.ndim == 2:
            mean, S = mean[:, None], S[:, None]
        N, r, m = mean.shape
        put("log_weight", _log_weight(self.log_weight, N, r))
        angular = np.zeros(m, dtype=bool) if self.angular is None else np.asarray(self.angular)
        if angular.shape != (m,) or angular.dtype != np.bool_:
            raise ValueError(f"angular: expected {m} booleans, got {self.angular!r}")
        put("angular", angular)
        known: Mask = np.asarray(np.isfinite(mean).all(axis=1))
        both = known[:, None, :, None] & known[:, None, None, :]
        S = np.where(both, gaussian.symmetric(S), np.eye(m))
        mean = np.where(known[:, None], mean, 0.0)
        if not np.all(np.isfinite(S)) or np.any(np.einsum("...ii->...i", S) <= 0.0):
            raise ValueError("covariance: expected finite numbers and positive variances")
        # modes on one branch of an angle, so that they average
        apart = mean - mean[:, :1]
        mean = np.where(angular, mean[:, :1] + gaussian.wrap(apart), mean)
        put("mean", mean)
        put("covariance", S)
        put("known", known)

    @property
    def count(self) -> int:
        """Number of targets N."""
        return int(self.mean.shape[0])

    @property
    def size(self) -> int:
        """Number of rows m of the measurement model."""
        return int(self.mean.shape[-1])

    def bank(self) -> tuple[Array, Array]:
        """Return mean (N, m) and covariance (N, m, m) of the whole bank; unknown rows neutral."""
        return mixture.moments(np.exp(self.log_weight), self.mean, self.covariance)


def _log_weight(value: Any, N: int, r: int) -> Array:
    if value is None:
        if r != 1:
            raise ValueError(f"log_weight: needed for {r} modes")
        return np.zeros((N, 1))
    try:
        log_weight = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"log_weight: expected numbers, got {value!r}") from error
    if log_weight.shape != (N, r):
        raise ValueError(f"log_weight: expected shape {(N, r)}, got {log_weight.shape}")
    if not np.allclose(np.exp(log_weight).sum(axis=-1), 1.0, rtol=0.0, atol=1e-6):
        raise ValueError("log_weight: expected logs of weights that sum to 1 for each target")
    return log_weight


class Block(NamedTuple):
    """Candidates of which each target has at most one, and each at most one target.

    Attributes
    ----------
    columns : (q,)
        Rows of the measurement model that occur.
    z : (L, q)
        What was measured; NaN is missing.
    members : (L, q)
        Index of each number in the scan; -1 where it is missing.
    """

    columns: Index
    z: Array
    members: Index

    def part(self, candidates: Index) -> Block:
        """Return some of the candidates."""
        return Block(self.columns, self.z[candidates], self.members[candidates])


@attrs.frozen(eq=False)
class Unlabelled:
    """The rows of one scan, in any order.

    Parameters
    ----------
    values : (K,)
        What was measured, internal units; NaN counts as not measured.
    row : (K,) int
        Row of the measurement model (which station pair) that each value is of.
    emission : (K,) int, optional
        Values with the same number came from one emission and stay together: they have the same
        target, or none. Default: nothing is known of that.

    Raises
    ------
    ValueError
        Shapes that do not fit, infinite values, a row number that is negative or no integer, two
        values of one row in one emission.
    """

    values: Array = attrs.field(converter=_values)
    row: Index = attrs.field(converter=_row)
    emission: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        K = len(self.values)
        if self.row.shape != (K,):
            raise ValueError(f"row: expected {K} row numbers, got shape {self.row.shape}")
        if np.any(self.row < 0):
            raise ValueError(f"row: expected numbers from 0, got {int(self.row.min())}")
        if self.emission is None:
            return
        emission = _integers("emission", self.emission)
        if emission.shape != (K,):
            raise ValueError(f"emission: expected {K} numbers, got shape {emission.shape}")
        pairs, count = np.unique(np.stack([emission, self.row]), axis=1, return_counts=True)
        if np.any(count > 1):
            e, i = (int(v) for v in pairs[:, np.argmax(count)])
            raise ValueError(f"emission: emission {e} has more than one value of row {i}")
        object.__setattr__(self, "emission", emission)

    def blocks(self, size: int) -> list[Block]:
        """Return the candidates for a measurement model of `size` rows.

        One block per row that was measured; or, where emissions are known, one block of them all.
        """
        if len(self.row) and self.row.max() >= size:
            raise ValueError(
                f"row: expected row numbers below {size}, the size of the prediction, "
                f"got {int(self.row.max())}"
            )
        there = np.flatnonzero(np.isfinite(self.values))
        if self.emission is not None:
            return [self._together(there)] if len(there) else []
        result = []
        for i in np.unique(self.row[there]):
            k = there[self.row[there] == i]
            result.append(Block(np.array([i]), self.values[k, None], k[:, None]))
        return result

    def _together(self, there: Index) -> Block:
        columns, column = np.unique(self.row[there], return_inverse=True)
        names, which = np.unique(self.emission[there], return_inverse=True)
        members = np.full((len(names), len(columns)), -1, dtype=np.int64)
        members[which, column] = there
        z = np.where(members >= 0, self.values[members], np.nan)
        return Block(columns, z, members)


def _integers(name: str, value: Any) -> Index:
    array = np.asarray(value)
    if array.size == 0:
        return np.zeros(array.shape, dtype=np.int64)
    if not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name}: expected whole numbers, got {value!r}")
    return array.astype(np.int64)


@attrs.frozen(eq=False)
class Association:
    """Which of the scan's K values belong to which of N targets.

    Attributes
    ----------
    weight : (N, K)
        Probability that the value is the target's; 0 or 1 where the associator decides.
    missed : (N, m)
        Probability that the row of the target is none of the values.
    values : (N, m)
        What each target takes, to be given to `IMM.step`; NaN is nothing. All NaN where the
        associator weighs instead of deciding.
    innovation, covariance : (N, r, m), (N, r, m, m), optional
        Only where it weighs: what the target's rows are now believed to have been, less the
        prediction, and the covariance that is left of them, in each mode (`soft_update`).
    log_likelihood_ratio : (N, r), optional
        Only where it weighs: log of how much likelier the scan is under each mode than if the
        target did not exist.
    """

    weight: Array
    missed: Array
    values: Array
    innovation: Array | None = None
    covariance: Array | None = None
    log_likelihood_ratio: Array | None = None

    @property
    def decided(self) -> bool:
        """Whether each value was given wholly to a target or to none."""
        return self.innovation is None

    @property
    def unclaimed(self) -> Array:
        """Probability (K,) that a value is no target's; what new tracks begin from."""
        result: Array = np.clip(1.0 - self.weight.sum(axis=0), 0.0, 1.0)
        return result


@runtime_checkable
class Associator(Protocol):
    """Anything that says which unlabelled rows belong to which target."""

    def __call__(self, prediction: Prediction, scan: Unlabelled) -> Association:
        """Return who takes which of the scan's values."""
        ...


def decided(taken: Index, prediction: Prediction, scan: Unlabelled) -> Association:
    """Return the association in which target n takes value `taken` (N, m), -1 being none."""
    N, m = taken.shape
    weight = np.zeros((N, len(scan.values)))
    n, i = np.nonzero(taken >= 0)
    weight[n, taken[n, i]] = 1.0
    values = np.full((N, m), np.nan)
    values[n, i] = scan.values[taken[n, i]]
    return Association(weight, np.where(taken >= 0, 0.0, 1.0), values)
