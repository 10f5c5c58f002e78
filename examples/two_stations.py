"""Two receivers, one of them flying: one hyperbola after another until a single place is left."""

import numpy as np

from imm_tdoa import GaussianSum, Stations, gaussian_sum
from imm_tdoa.models import TDOA, Static

# A station on the ground and a drone on its way past it; an emitter 21 km off that stands still.
times = np.arange(0.0, 241.0, 5.0)
drone = np.array([12e3, -3e3]) + times[:, None] * np.array([-20.0, 45.0])
path = np.stack([np.zeros_like(drone), drone], axis=1)  # (T, 2 stations, 2), m
measurement = TDOA(Stations(path, times=times, names=["ground", "drone"]), toa_sigma=100e-9)
emitter = np.array([15e3, 15e3])
clean = measurement.predict(emitter, np.zeros(2), times) / measurement.speed
tdoa = clean + np.random.default_rng(5).normal(0.0, np.sqrt(2.0) * 100e-9, clean.shape)

# The first difference leaves a whole branch of a hyperbola, here up to 60 km out: 60 Gaussians.
# Each is a Kalman filter of its own; the later differences decide between them.
start = gaussian_sum.hyperbola(measurement, times[0], tdoa[0], reach=60e3, count=60)
gs = GaussianSum(Static(psd=0.0), measurement, merge_distance=500.0)
track = gs.run(times[1:], tdoa[1:], gs.start(times[0], *start))

print(" time   places   estimate [km]      sigma     error")
for k in (0, 5, 11, 23, 47):
    x, y = 1e-3 * track.position[k]
    sigma = np.sqrt(np.trace(track.position_covariance[k]))
    error = np.linalg.norm(track.position[k] - emitter)
    places = np.count_nonzero(track.weight[k] > 0.01)
    place = f"({x:6.2f}, {y:6.2f})"
    print(f"{track.times[k]:4.0f} s  {places:4d}   {place}   {sigma:6.0f} m  {error:6.0f} m")
