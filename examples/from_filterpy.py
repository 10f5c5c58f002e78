"""Bring Kalman filters written for filterpy, and let them run as one bank.

Two filters of unequal dimension, constant velocity and constant acceleration, track a cart that
brakes. filterpy's own IMMEstimator takes filters of equal dimension only, and scores a missed
measurement with the last likelihoods; the bank does neither.
"""

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from imm_tdoa import IMM, interop

DT, SIGMA = 0.5, 2.0

cruise = KalmanFilter(dim_x=2, dim_z=1)
cruise.F = np.array([[1.0, DT], [0.0, 1.0]])
cruise.H = np.array([[1.0, 0.0]])
cruise.Q = Q_discrete_white_noise(dim=2, dt=DT, var=0.01)

brake = KalmanFilter(dim_x=3, dim_z=1)
brake.F = np.array([[1.0, DT, DT**2 / 2], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
brake.H = np.array([[1.0, 0.0, 0.0]])
brake.Q = Q_discrete_white_noise(dim=3, dt=DT, var=0.01)

for kf in (cruise, brake):
    kf.R[:] = SIGMA**2
    kf.P *= 100.0

# The components are known by name: x, vx, ax. Rows of the transition matrix sum to one.
bank, measurement, state = interop.from_filterpy(
    [cruise, brake],
    components=[("x", "vx"), ("x", "vx", "ax")],
    dt=DT,
    transition=[[0.98, 0.02], [0.02, 0.98]],
    names=("cruise", "brake"),
    birth_std={"acceleration": 3.0},
)

rng = np.random.default_rng(4)
t = DT * np.arange(1, 61)
truth = 20.0 * np.minimum(t, 15.0)
since = np.clip(t - 15.0, 0.0, None)
truth = truth + 20.0 * since - 0.5 * since**2  # from 15 s on it slows down by 1 m/s²
values = truth + rng.normal(0.0, SIGMA, t.shape)
values[20:24] = np.nan  # two seconds without a measurement

track = IMM(bank, measurement).run(t, values[:, None], start=state)
print("time     error   P(brake)   acceleration")
for k in (9, 23, 29, 39, 59):
    error = track.position[k, 0] - truth[k]
    print(f"{t[k]:4.1f} s {error:6.2f} m   {track.mode_probability[k, 1]:5.2f}", end="")
    print(f"   {track.mean[k, 2]:8.2f} m/s²")

# And back: filterpy objects that go on from where the bank stands.
state = IMM(bank, measurement).step(state, DT, values[:1])
filters, mode_probability, transition = interop.to_filterpy(bank, measurement, DT, state)
print(f"\nback in filterpy after one scan: x = {filters[1].x.ravel().round(2)}")
