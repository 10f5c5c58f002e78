"""Read a recording of your own: write the folder, look at it, track it.

A recording is a folder with recording.toml, stations.csv and what was measured. Here it is
written from Python; any program that writes CSV will do.
"""

import tempfile
from pathlib import Path

import numpy as np

from imm_tdoa import IMM, Bank, recording
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity

folder = Path(tempfile.mkdtemp()) / "my-recording"
folder.mkdir()
(folder / "recording.toml").write_text(
    """\
format = 1
title = "A drone over five receivers"
speed_mps = 299792458.0
dims = 3
labelled = true

[frame]
kind = "local"

[noise]
toa_sigma_s = 20e-9
"""
)
receivers = {
    "north": (0.0, 2_000.0, 10.0),
    "east": (2_000.0, 0.0, 60.0),
    "south": (0.0, -2_000.0, 5.0),
    "west": (-2_000.0, 0.0, 150.0),
    "tower": (300.0, 200.0, 80.0),
}
lines = ["station,x_m,y_m,z_m"] + [f"{n},{x},{y},{z}" for n, (x, y, z) in receivers.items()]
(folder / "stations.csv").write_text("\n".join(lines) + "\n")

# Arrival times: one emission a second, its own time unknown, every fifth arrival missing.
rng = np.random.default_rng(7)
times = np.arange(90.0)
turn = 2 * np.pi * times / 90
drone = np.stack([800 * np.sin(turn), 800 * np.cos(turn), 300 + 2 * times], axis=-1)
lines = ["time_s,emission,station,toa_s"]
for k, t in enumerate(times):
    for name, place in receivers.items():
        if rng.random() > 0.2:
            arrival = t + np.linalg.norm(drone[k] - place) / 299792458.0 + rng.normal(0, 20e-9)
            lines.append(f"{t:.3f},e{k},{name},{arrival:.12f}")
(folder / "toa.csv").write_text("\n".join(lines) + "\n")

rec = recording.read(folder)
measurement, times, values, pairs = rec.scans()
print(f"{rec.title!r}: {len(times)} scans of up to {values.shape[1]} arrivals")

bank = Bank(
    [ConstantVelocity(psd=0.5), ConstantAcceleration(psd=1.0)],
    mean_sojourn=20.0,
    birth_std={"velocity": 30.0, "acceleration": 5.0},
)
track = IMM(bank, measurement, robust="gate").run(times, values, pairs=pairs)
recording.write_track(folder / "track.csv", {"drone": track})

start = len(times) - len(track.times)  # scans that the first fix gathered
error = np.linalg.norm(track.position - drone[start:], axis=-1)
print(f"tracked from {track.times[0]:.0f} s, median error {np.median(error):.1f} m")
print((folder / "track.csv").read_text().splitlines()[0])
print(f"The same from a shell: imm-tdoa track {folder.name} --bank drone")
