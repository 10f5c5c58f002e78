"""Write a motion model of your own, and let the conformance kit check it.

The model: a target pulled back towards a point, such as a boat at anchor swinging on its
chain. Its velocity decays by itself (Ornstein-Uhlenbeck), so its speed stays bounded.
"""

import attrs
import numpy as np
from scipy.linalg import expm

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.contract import LinearMotion, component_names
from imm_tdoa.models import TDOA, ConstantVelocity
from imm_tdoa.testing import check_motion_model


@attrs.frozen
class DampedVelocity(LinearMotion):
    """Velocity that decays with time constant tau, driven by white acceleration noise.

    Per axis d/dt [p; v] = A [p; v] + [0; 1] w, A = [0 1; 0 -1/tau]. F = exp(A dt), and Q from
    the same exponential by Van Loan's construction.

    Parameters
    ----------
    psd : float
        Density of the acceleration noise w, m²/s³.
    tau : float
        Time constant, s.
    """

    psd: float = 1.0
    tau: float = 30.0

    def components(self, dims):
        if dims not in (1, 2, 3):
            raise ValueError(f"dims: expected 1, 2 or 3, got {dims!r}")
        return component_names(dims, order=1)

    def transition(self, dt, dims):
        return self._for_all_axes(self._van_loan(dt)[0], dims)

    def process_noise(self, dt, dims):
        return self._for_all_axes(self._van_loan(dt)[1], dims)

    def _van_loan(self, dt):
        dt = np.asarray(dt, dtype=float)
        if not np.all(np.isfinite(dt)) or np.any(dt < 0):
            raise ValueError(f"dt: expected a finite time step of at least 0 s, got {dt}")
        A = np.array([[0.0, 1.0], [0.0, -1.0 / self.tau]])
        M = np.block([[-A, np.diag([0.0, self.psd])], [np.zeros((2, 2)), A.T]])
        E = expm(M * dt[..., None, None])
        F = np.swapaxes(E[..., 2:, 2:], -1, -2)
        return F, F @ E[..., :2, 2:]

    def _for_all_axes(self, per_axis, dims):
        self.components(dims)  # refuses a bad dims
        full = np.einsum("...ab,ij->...aibj", per_axis, np.eye(dims))
        return full.reshape(*per_axis.shape[:-2], 2 * dims, 2 * dims)


check_motion_model(DampedVelocity(psd=0.5, tau=20.0))
print("DampedVelocity keeps every law of a motion model.")


@attrs.frozen
class Forgetful(DampedVelocity):
    """The same with a slip: the noise does not reach the position."""

    def process_noise(self, dt, dims):
        Q = super().process_noise(dt, dims).copy()
        Q[..., :dims, :] = Q[..., :, :dims] = 0.0
        return Q


try:
    check_motion_model(Forgetful())
except AssertionError as broken:
    print(f"\nForgetful does not, and the kit says why:\n{broken}")

# The model goes into a bank like any other.
stations = Stations([[0, 0], [9_000, 1_000], [4_000, 8_000], [-3_000, 6_000]])
bank = Bank([DampedVelocity(psd=0.5, tau=20.0), ConstantVelocity(psd=0.01)], mean_sojourn=60.0)
imm = IMM(bank, TDOA(stations, toa_sigma=30e-9))
state = imm.start(0.0, mean=[2_000.0, 3_000.0], covariance=np.diag([1e4, 1e4]))
state = imm.step(state, 1.0, np.zeros(3) * np.nan)  # nothing heard: the prediction
shares = ", ".join(f"{n} {p:.2f}" for n, p in zip(state.modes, state.mode_probability, strict=True))
print(f"\nafter 1 s without a measurement: {shares}")
