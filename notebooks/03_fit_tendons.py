# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Fit tendon stiffness from motion, and how sure it is
#
# A patella's recorded motion holds the stiffness and the slack length of the tendons that made it, but not all of it
# equally well, and a knee is never quite its model. You will get:
#
# 1. before any measurement: what this motion can tell at best, and which further measurement would help most;
# 2. quick fits to what a laboratory has, positions and one force, and why their intervals are not to be relied on;
# 3. the fit to report: what the twin lacks (friction, attachments, springs that stiffen) is found besides, from
#    thousands of simulated knees, and intervals hold the springs that made the measurements;
# 4. a prediction: the treated knee's motion and forces from springs fitted to the untreated one, with bands.
#
# The knee is case 2 of the virtual rig. **Its measurements are synthetic**: a second model made them that differs from
# the twin in contact, friction, springs and attachments, as a real knee would, and noise was added.

# %%
# %matplotlib inline
import matplotlib as mpl
import numpy as np
from IPython.display import Markdown

import fitting
import pftwin
from fitting.demo.straight_springs import nearest_line, recorded_pulls
from pftwin.base.runtime import default_cache_dir
from pftwin.results.plots import compared

pftwin.configure(cache_dir=default_cache_dir())  # double precision and fast code, kept for the next time
mpl.rcParams["figure.dpi"] = 72  # small files
scene, measured = pftwin.rig.case(2, contact="P5"), pftwin.rig.measured(2)
assert measured.synthetic


def table(head, rows):
    """A table in Markdown."""
    return Markdown("\n".join(f"| {' | '.join(map(str, line))} |" for line in (head, ["---"] * len(head), *rows)))


# %% [markdown]
# ## Before measuring
#
# The Cramer-Rao bound says what any unbiased fit could reach at best, from exact derivatives of the simulation alone.
# K1 and L1 are stiffness and slack length of the quadriceps' tendon, K2 and L2 those of the patellar tendon. Noise is
# 0.2 mm in position and 0.15 N in a force.

# %%
computed = fitting.channels_of(scene)  # fits below pick from what the plan's program computes, and compile nothing anew
plan = fitting.plan_experiment(scene)
print(plan.sentence())


def percent(values):
    return [f"{100 * v:.2g} %" for v in values]


rows = [["position alone", *percent(plan.relative)]]
rows += [[f"and {name.replace('_', ' ')}", *percent(values)] for name, values in plan.additions.items()]
table(["measured", *plan.names], rows)

# %% [markdown]
# So in theory this motion tells everything: the patella swings out of its groove and falls, and its weight and inertia
# show how strongly it is held. **In theory** means: were the twin an exact image of the knee, and were errors
# independent from frame to frame.
#
# What is weak is the common scale. Slowly and without friction the patella rests where forces balance: multiply both
# tensions and the contact force by ten, and it rests in the same place. One force, of whatever tendon, settles that.

# %%
worst = {name: float(np.max(values)) for name, values in plan.additions.items()}
best = min(worst, key=worst.get)
print(f"helps most: {best}")
assert worst[best] < 0.5 * plan.relative.max()

# %% [markdown]
# ## A quick fit
#
# Least squares by Levenberg and Marquardt, from 32 starts side by side, with exact derivatives; in a second. The rig's
# laboratory has the force in the quadriceps' spring as well.

# %%
positions = fitting.fit_tendons(scene, measured, use="position", computed=computed)
print(positions.summary())
assert positions.dropped < positions.starts
assert not positions.at_bounds or "at a bound" in positions.summary()

# %%
quick = fitting.fit_tendons(scene, measured, use=("position", "quadriceps"), computed=computed)
print(quick.sentence())
quick.plot.correlation()

# %% [markdown]
# What should it have found? The springs that made these measurements stiffen as they are stretched, and the twin's are
# straight lines. The best that it can find is the line nearest to them over the forces that occurred: the truth below.

# %%
lines = {name: nearest_line(pull) for name, pull in recorded_pulls(2).items()}
truth = np.array([v for name in ("quadriceps", "patellar_tendon") for v in lines[name][:2]])


def beside_the_truth(estimates):
    """Values with half widths of their 95 % intervals, in % of the truth, and which intervals hold it."""
    rows = []
    for name, e in estimates.items():
        off, half = 100 * (e.values[:4] / truth - 1), 50 * np.ptp(e.intervals[:4], axis=1) / truth
        held = (e.intervals[:4, 0] <= truth) & (truth <= e.intervals[:4, 1])
        rows.append(
            [
                name,
                *(
                    f"{o:+.1f} ± {h:.1f}{'' if there else ' (missed)'}"
                    for o, h, there in zip(off, half, held, strict=True)
                ),
            ]
        )
    return table(["fit, off [%]", "K1", "L1", "K2", "L2"], rows)


beside_the_truth({"quick, positions": positions, "quick, and one force": quick})

# %% [markdown]
# From positions alone it ends at a bound, and its intervals miss. With the force they hold the truth, by luck: over
# other plants that differ from the twin they do so in 34 to 76 % of cases. Residuals show why. Neighbouring ones are
# correlated by 0.99, which is a model's error and no noise; intervals allow for that correlation, not for what the
# model's error does to the values.

# %%
assert quick.serial_correlation > 0.9
print(f"left of the positions: {1e3 * quick.rmse['position']:.2f} mm")
assert quick.rmse["position"] > 5e-4

# %% [markdown]
# ## The fit to report
#
# What the twin lacks is part of this fit, with priors as wide as a laboratory is unsure: friction, damping, attachments
# to within a millimetre or two, springs that stiffen by up to 10 %. The groove is the mesh's own shape, a spline.
# Knees are drawn from the priors and simulated, and networks learn from them what recordings tell. Trained once, they
# answer every recording of this set-up in seconds.

# %%
surface = pftwin.rig.case(2, contact="spline")
trained = fitting.train_posterior(surface, measured, use=("position", "quadriceps"), nuisance="rig", simulations=8_000)
print(trained.sentence())
estimate = trained.estimate(surface, measured)
print(estimate.sentence())
assert not estimate.invalid

# %%
beside_the_truth({"quick, and one force": quick, "by simulations, and one force": estimate})

# %%
held = (estimate.intervals[:4, 0] <= truth) & (truth <= estimate.intervals[:4, 1])
assert held.all()
left = {name: e.rmse["position"] for name, e in (("quick", quick), ("by simulations", estimate))}
print({name: f"{1e3 * value:.2f} mm of the positions left unexplained" for name, value in left.items()})
assert left["by simulations"] < 0.4 * left["quick"]

# %% [markdown]
# These intervals are wider than the quick fit's, and say what one recording can tell of a knee that is not quite its
# twin. One knee proves little. `pftwin calibrate` repeats this on many simulated knees that differ from the twin in
# other ways than the priors say, and counts:
# [how often intervals hold the truth](../docs/fitting.md#how-sure-intervals-and-their-measured-coverage).

# %% [markdown]
# ## Predict the treated knee
#
# Case 1 is the same knee after its tuberosity was moved medially: same springs, another motion. Its measurements took
# no part in the fits. Friction and attachments that were found are carried over as offsets.

# %%
seen = pftwin.rig.measured(1)
foretold = {
    "nominal": pftwin.simulate(pftwin.rig.case(1, contact="P5")),
    "quick fit": pftwin.simulate(quick.apply(pftwin.rig.case(1, contact="P5"))),
    "by simulations": pftwin.simulate(estimate.apply(pftwin.rig.case(1, contact="spline"))),
}
distance = {name: pftwin.validate(r, seen).mean_distance for name, r in foretold.items()}
print({name: f"{d:.2f} mm from the synthetic measurements" for name, d in distance.items()})
assert not foretold["by simulations"].dislocations().events
assert distance["by simulations"] < 0.4
compared(foretold, seen)

# %% [markdown]
# Michaud et al. (2024) came to 2.61 mm on their real rig. Here the measurements are synthetic, and both models share
# what [the README lists](../README.md#the-rigs-measurements-are-synthetic).
#
# Bands of the prediction come from draws of the posterior, nuisance included:

# %%
bands = fitting.predict(pftwin.rig.case(1, contact="spline"), estimate=estimate, samples=50)
draws = bands["mean_contact_force"].values[0, 1:]
low, high = np.quantile(draws, 0.05), np.quantile(draws, 0.95)
force = np.nanmean(seen.contact_force)
print(f"mean contact force of case 1: {low:.2f} to {high:.2f} N in nine of ten draws; measured {force:.2f} N")
assert low < force < high

# %% [markdown]
# ## Where next
#
# [Predict and optimise a treatment](04_treatment.ipynb) carries these uncertainties into a decision.
# [Fit parameters](../docs/fitting.md) has the theory, and the paper's way, a genetic algorithm
# (`method="matlab_ga", objective="paper"`); `pftwin demo` does this beside the paper's Table 2. The
# [worked patient](../docs/worked_knees.md#an-implant-as-a-patient) does all of this on the recording of an implant and compares
# with forces that the fit did not see.
