"""What came of a run, in Python: python analysis.py RUN (a folder that `mdb up` named at its end)."""

import sys

import numpy as np

from mdb_deploy import Run

run = Run(sys.argv[1])  # `run("my-cart", seed=2)`, also of mdb_deploy, makes one
print(run)

done = run.iterations  # a dict of numpy arrays, one value an iteration; nan where there is none
for phase in dict.fromkeys(done["phase"]):
    there = done["phase"] == phase
    reports = f"{there.sum()} iterations, {np.mean(done['event'][there] != 'none'):.1%} ended an episode"
    judged = done["feedback"][there]
    print(f"{phase}: {reports}, mean feedback {np.nanmean(judged) if np.isfinite(judged).any() else np.nan:.2f}")

for name in dict.fromkeys(run.models["model"]):  # how well each model knows its memory at the end
    errors = run.models["error"][run.models["model"] == name]
    print(f"model {name}: {len(errors)} versions, error {errors[0]:.3f}, then {errors[-1]:.3f}")

pairs = run.pairs  # before.NAME, action.NAME, after.NAME, feedback, ...
print(f"{len(pairs['iteration'])} pairs, of which {np.isfinite(pairs['feedback']).sum()} were judged")
