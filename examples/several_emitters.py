"""Emitters that nobody has told apart: three ways to say whose rows are whose, side by side."""

import argparse
from collections import Counter

from imm_tdoa import Bank, Tracker, simulate
from imm_tdoa.following import follow
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity

options = argparse.ArgumentParser(description=__doc__)
options.add_argument("--runs", type=int, default=1, help="of each scene; more say more (100)")
runs = options.parse_args().runs


def bank(speed: float) -> Bank:
    """Emitters of about `speed`, m/s, that fly straight on or gently speed up and slow down."""
    models = [ConstantVelocity(psd=0.1), ConstantAcceleration(psd=0.001)]
    return Bank(
        models, mean_sojourn=60.0, birth_std={"velocity": speed, "acceleration": speed / 100.0}
    )


# Scene: the bank that fits it, and how far a track may be from the emitter that it follows, m.
scenes = {
    "crossing": (bank(30.0), 25.0),  # two paths at ten degrees; a fix is good to 9 m per axis
    "parallel": (bank(30.0), 25.0),  # side by side, three of those apart
    "three-emitters": (bank(700.0), 5000.0),  # 500 km off; as many false differences as true ones
}

print(f"{runs} run{'s' * (runs > 1)} of each scene; GOSPA over the last 40 scans\n")
print("scene           rows go to            kept   mean GOSPA m   id switches   false tracks")
for scene, (models, cutoff) in scenes.items():
    for associator in ("nearest", "global", "jpda", "who sent them"):
        kept, distance, counts = 0, 0.0, Counter()
        for seed in range(runs):
            made = simulate.simulate_labelled(simulate.load(scene), seed)
            told = associator == "who sent them"  # somebody knows: what cannot be beaten
            data = made.told_apart() if told else made.recording
            tracks = (Tracker(models) if told else Tracker(models, associator=associator)).run(data)
            confirmed = {name: life.confirmed for name, life in tracks.lives.items()}
            times = sorted(set(data.truth["time_s"]))
            one = follow(tracks, data, times, confirmed=confirmed, cutoff=cutoff)
            at_the_end = (one.follower[:, -5:] >= 0).any(axis=1)
            kept += bool(at_the_end.all() and not one.id_switches.any())
            distance += one.gospa.distance[-40:].mean() / runs
            counts["switches"] += one.id_switches.sum()
            counts["false"] += one.false_tracks.sum()
        print(
            f"{scene:15} {associator:18} {kept:3} of {runs:<3} {distance:10.1f} "
            f"{counts['switches']:13} {counts['false']:14}"
        )
    print()
print("kept: runs in which every emitter still has, at the end, the track that it began with")
