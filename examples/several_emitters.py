"""Emitters that nobody has told apart: three ways to say whose rows are whose, side by side."""

import argparse

from imm_tdoa import Bank, Tracker, simulate
from imm_tdoa.following import follow
from imm_tdoa.models import ConstantVelocity


def bank(speed: float) -> Bank:
    """Emitters of about `speed`, m/s, that fly straight on."""
    return Bank([ConstantVelocity(psd=0.01)], birth_std={"velocity": speed})


# Scene: the bank that fits it, and how far a track may be from the emitter that it follows, m.
scenes = {
    "crossing": (bank(30.0), 25.0),  # two paths at ten degrees; a fix is good to 9 m per axis
    "parallel": (bank(30.0), 25.0),  # side by side, three of those apart
    "three-emitters": (bank(700.0), 5000.0),  # 500 km off; as many false differences as true ones
}

options = argparse.ArgumentParser(description=__doc__)
options.add_argument("scene", nargs="*", help=f"of {', '.join(scenes)}; default the first two")
options.add_argument("--runs", type=int, default=1, help="of each scene; more say more (100)")
asked = options.parse_args()
runs, chosen = asked.runs, asked.scene or ["crossing", "parallel"]

print(f"{runs} run{'s' * (runs > 1)} of each scene; GOSPA over the last 40 scans\n")
print("scene           rows go to      in 8 scans    all kept  GOSPA m  id switches  false tracks")
for scene in chosen:
    models, cutoff = scenes[scene]
    for associator in ("nearest", "global", "jpda", "who sent them"):
        early, kept, switches, false, distance = 0, 0, 0, 0, 0.0
        for seed in range(runs):
            made = simulate.simulate_labelled(simulate.load(scene), seed)
            if associator == "who sent them":  # somebody knows: it cannot be done better
                data, tracker = made.told_apart(), Tracker(models)
            else:
                data, tracker = made.recording, Tracker(models, associator=associator)
            tracks = tracker.run(data)
            one = follow(tracks, data, cutoff=cutoff)
            first, last = (
                {t for t in row if t >= 0} for row in (one.follower[:, 20], one.follower[:, -1])
            )
            early += bool((one.follower[:, :8] >= 0).any(axis=1).all())
            kept += first == last and len(last) == len(one.targets)
            switches += one.id_switches.sum()
            false += one.false_tracks.sum()
            distance += one.gospa.distance[-40:].mean() / runs
        print(
            f"{scene:15} {associator:14} {early:4} of {runs:<4} {kept:3} of {runs:<4}"
            f" {distance:7.1f} {switches:12} {false:13}"
        )
    print()
print("in 8 scans: every emitter has a confirmed track within the first eight")
print("kept: the emitters have the same tracks in the 20th scan and in the last, whoever has which")
