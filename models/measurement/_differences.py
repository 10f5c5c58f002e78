"""What measurement models of differences between stations share (`TDOA`, `FDOA`)."""

from __future__ import annotations

from typing import Any, Self

import attrs
import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import incidence
from imm_tdoa.models.measurement import _sigma
from imm_tdoa.models.measurement._pairs import shared_noise, spanning_rows
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import pair_index


class DifferenceMeasurement(ReceiverMeasurement):
    """Differences between the stations of each pair, station minus reference.

    Noise is given either per station, and then differences that share one are correlated
    (R = D diag(sigma²) D', ALGORITHMS §1.1), or per difference, independent of the others.
    """

    pairs: Any
    sigma_times: Any

    def _check(self, shared: str, own: str) -> None:
        """Check the pairs and the one sigma given: `shared` per station or `own` per row."""
        given = {name: getattr(self, name) for name in (shared, own)}
        if (given[shared] is None) == (given[own] is None):
            raise ValueError(
                f"{type(self).__name__}: give exactly one of {shared} (per station) and {own} "
                f"(per difference), got {shared}={given[shared]!r}, {own}={given[own]!r}"
            )
        put = object.__setattr__
        put(self, "pairs", pair_index(self.pairs, self.stations))
        name = shared if given[own] is None else own
        rows = len(self.stations) if name == shared else self.size
        value, times = _sigma.checked(name, given[name], rows, self.sigma_times)
        put(self, name, value)
        put(self, "sigma_times", times)

    def _covariance(self, shared: str, own: str, time: float | Array) -> Array:
        """Return the covariance (..., m, m) of the differences in the units of the sigmas."""
        per_station, per_row = getattr(self, shared), getattr(self, own)
        if per_row is not None:
            sigma = _sigma.at(own, per_row, self.sigma_times, time, self.size)
            result: Array = sigma[..., None] ** 2 * np.eye(self.size)
            return result
        sigma = _sigma.at(shared, per_station, self.sigma_times, time, len(self.stations))
        return shared_noise(sigma**2, self.pairs)

    def _sources(
        self, shared: str, own: str, scale: float, position: Array, velocity: Array, time: Any
    ) -> tuple[Array, Array]:
        """Return the stations' own errors as sources where they are shared, else the rows'."""
        if getattr(self, shared) is None:
            return super().error_sources(position, velocity, time)
        sigma = scale * _sigma.at(
            shared, getattr(self, shared), self.sigma_times, time, len(self.stations)
        )
        return incidence(self.pairs, len(self.stations)), sigma**2

    def _of_differences(self, rows: Array) -> Array:
        """Take derivatives by each station's own state, (..., S, d), to (..., m, S, d)."""
        D = incidence(self.pairs, len(self.stations))
        return D[..., None] * rows[..., None, :, :]

    @property
    def size(self) -> int:
        """Number of rows m."""
        return int(self.pairs.shape[-2])

    def heard(self, present: Mask) -> Mask:
        """Return which stations (..., S) are in a `present` pair (..., m)."""
        D = np.abs(incidence(self.pairs, len(self.stations)))
        heard: Mask = np.einsum("...m,...ms->...s", present.astype(float), D) > 0.0
        return heard

    def _without_loops(self, present: Mask, shared: Any) -> Mask:
        return present if shared is None else spanning_rows(self.pairs, present)

    def with_pairs(self, pairs: Any) -> Self:
        """Return the same measurement between other station pairs (..., m, 2)."""
        return attrs.evolve(self, pairs=pairs)  # type: ignore[misc]
