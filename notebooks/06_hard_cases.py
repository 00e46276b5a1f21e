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
# # Hard cases, and what the statuses mean
#
# A simulated value is useful only if you know how reliable it is. You will get:
#
# 1. six scenes that break contact simulators, simulated and drawn: a slow touch, a bounce, a saddle, a dislocation
#    across the edge of the surface, steps that are too long, and input that is refused;
# 2. all statuses with which pftwin reports how far to trust a result, listed from the code;
# 3. a part of the matrix that judges such scenes by conditions that every simulation must meet.
#
# All scenes here are invented: this is about the method, not about a patient. Statements about figures are followed by
# an `assert`, which stops the notebook if one is wrong; times are shown but never checked.

# %%
# %matplotlib inline
from dataclasses import replace

import matplotlib as mpl
import numpy as np
from IPython.display import Markdown
from matplotlib.figure import Figure

import pftwin
from pftwin.results.plots import COLOURS, STYLE
from pftwin.studies import hard_cases
from pftwin.studies.hard_cases import table as tables

pftwin.configure(cache_dir=True)  # double precision and fast code, kept for the next time
print(f"{len(hard_cases.catalogue())} hard cases are kept with the project")


def table(head, rows):
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return Markdown("\n".join(f"| {' | '.join(map(str, line))} |" for line in lines))


# %% [markdown]
# ## The scenes
#
# Nine scenes come from the catalogue (`pftwin hard-cases --list` shows all). Two more repeat the bounce with shorter
# steps.

# %%
NAMES = (
    "slow_touch",
    "bounce_to_rest",
    "sphere_on_a_ridge",
    "ridge_left_of_the_crest",
    "dislocation_across_the_edge",
    "contact_hard",
    "radius_negative",
    "tendon_stiffness_negative",
    "motion_not_finite",
)
cases = [hard_cases.case_named(name) for name in NAMES]
for step in ("0.1 ms", "0.01 ms"):
    about = f"The same in steps of {step}."
    cases.append(replace(cases[1], name=f"bounce in {step}", about=about, step=1e-3 * float(step.split()[0])))

table(["scene", "what is hard about it"], [[c.name, c.about] for c in cases])

# %% [markdown]
# All use the contact of a sphere on a polynomial patch (P5). They are simulated twice: with `linear_implicit` in steps
# of 1 ms unless the scene states others, and with `symplectic_euler`, an explicit method, in steps of 0.1 ms or less.
#
# Each scene returns a result, or the error with which it was refused. Every frame of a result has a **status**: "ok",
# or flags that say in words what happened.

# %%
INTEGRATORS = ("linear_implicit", "symplectic_euler")
ran = {name: hard_cases.results(cases, contact="P5", integrator=name) for name in INTEGRATORS}
default = ran["linear_implicit"]


def said(found):
    """Status of a result, or message of a refusal."""
    return f"refused: {found}" if isinstance(found, pftwin.InputError) else found.status.describe()


table(["scene", "status of the simulation with linear_implicit"], [[name, said(f)] for name, f in default.items()])

# %% [markdown]
# "The run did not start from a converged equilibrium" appears wherever the scene starts the patella in mid-air, as
# intended. A simulation of a knee starts from its static equilibrium and must not have this flag.
#
# ## A slow touch
#
# A button is released a nanometre above a plate. Contact laws with damping divide by the approach speed, which is
# nearly zero here, and many codes then return an infinite force. The force must rise to the weight and stay there.

# %%
touch = default["slow_touch"]
weight = 0.12 * 9.81  # [N]
force = touch.effects["contact"]["force"]
print(f"force after half a second: {force[-1]:.4f} N, weight {weight:.4f} N")
assert np.isfinite(force).all()
assert abs(force[-1] - weight) < 1e-3 * weight
assert force.max() < 1.5 * weight

# %% [markdown]
# ## A bounce
#
# A button is dropped by 3 mm with a coefficient of restitution of 0.5. It should rebound to about a quarter of that
# height, 0.75 mm, then to a sixteenth, and so on until it rests. The impact lasts about a millisecond.
#
# The figure shows the height above the plate (left) and the kinetic plus stored energy (right). Markers are frames, 10
# ms apart; the impact itself falls between two of them. In steps of 1 ms `linear_implicit` damps the impact away: the
# button lands and stays. It reaches the right rest position with the right force, but **it does not bounce**. Shorter
# steps make the rebound higher, towards what it should be. The explicit method rebounds higher than the implicit one in
# steps of the same length.

# %%
SHOWN = (
    ("linear_implicit", "bounce_to_rest"),
    ("linear_implicit", "bounce in 0.1 ms"),
    ("linear_implicit", "bounce in 0.01 ms"),
    ("symplectic_euler", "bounce in 0.01 ms"),
)
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(10.0, 3.8))
    height, energy = figure.subplots(1, 2)
    for k, (name, scene) in enumerate(SHOWN):
        run = ran[name][scene]
        early = run.times < 0.105
        label = f"{name}, {1e3 * run.settings['dt_s']:g} ms"
        line = {"color": COLOURS[k], "marker": "osD^"[k], "markersize": 4, "label": label}
        height.plot(1e3 * run.times[early], 1e3 * (run.center[:, 2] - run.center[-1, 2])[early], **line)
        energy.plot(1e3 * run.times[early], 1e3 * (run.energies.total - run.energies.total[-1])[early], **line)
    height.set(title="height above rest", xlabel="time [ms]", ylabel="[mm]")
    energy.set(title="kinetic and stored energy above rest", xlabel="time [ms]", ylabel="[mJ]")
    handles, labels = height.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.suptitle("bounce_to_rest (invented): dropped by 3 mm, restitution 0.5")
figure

# %% [markdown]
# How would you notice this without a second simulation to compare with? Every result has an **energy budget**, which
# separates the heat of damping from the energy that the time steps themselves removed or added. Here the drop released
# 3.5 mJ. `pftwin.simulate` also warns of impacts for which its steps are too long, and reports the restitution that
# they can give.

# %%
bounced, heat, taken = {}, {}, {}
for name, scene in (*SHOWN, ("symplectic_euler", "bounce in 0.1 ms")):
    run = ran[name][scene]
    key = name, 1e3 * run.settings["dt_s"]
    bounced[key] = 1e3 * (run.center[run.times > 0.025, 2].max() - run.center[-1, 2])
    heat[key], taken[key] = (1e3 * e[-1] for e in (run.energies.heat, run.energies.numerical_dissipation))
    assert abs(run.effects["contact"]["force"][-1] - weight) < 0.01 * weight  # the same rest for all
    left = run.energies.total - run.energies.work
    assert np.all(np.diff(left) < 1e-6)  # [J] no energy from nowhere

table(
    ["integrator", "step, ms", "highest frame after landing, mm", "heat, mJ", "removed by the steps, mJ"],
    [[name, f"{step:g}", *(f"{x[name, step]:.2f}" for x in (bounced, heat, taken))] for name, step in bounced],
)

# %%
implicit = [bounced["linear_implicit", step] for step in (1.0, 0.1, 0.01)]
assert implicit[0] < 0.05  # no bounce
assert implicit[0] < implicit[1] < implicit[2] < 0.75
assert implicit[2] < bounced["symplectic_euler", 0.01] < 0.85
assert taken["linear_implicit", 1.0] > 1.5 > 4 * taken["linear_implicit", 0.01]
assert abs(taken["symplectic_euler", 0.01]) < 0.1

# %% [markdown]
# A patella that glides under load has no such impacts. Where impacts matter, take short steps and check the energy
# budget.
#
# ## A saddle
#
# A ball on a crest may stay there or fall to either side. Exactly on the crest nothing distinguishes left from right,
# so a simulation that drifts off has an error with a preferred side. A micrometre beside the crest, the ball must fall
# to that side, at the rate that mechanics gives: the distance grows like exp(t / T), with T near 0.1 s here.
#
# The figure shows the distance from the middle plane on a logarithmic axis, on which exponential growth is a straight
# line. On the crest there is only rounding error, far smaller than an atom, and it grows at the same rate.

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(7.0, 3.4))
    axes = figure.subplots()
    for k, (name, label) in enumerate(
        {"ridge_left_of_the_crest": "let go 0.001 mm beside the crest", "sphere_on_a_ridge": "on it"}.items()
    ):
        run = default[name]
        axes.plot(
            run.times[1:], 1e3 * np.abs(run.center[1:, 1]), color=COLOURS[k], marker="os"[k], markersize=3, label=label
        )
    axes.set(yscale="log", ylim=(1e-17, 10), xlabel="time [s]", ylabel="from the middle plane [mm]")
    axes.set_title("A button on a ridge (invented)")
    figure.legend(loc="outside lower center", ncols=2)
figure

# %%
beside, on = default["ridge_left_of_the_crest"], default["sphere_on_a_ridge"]
late = beside.times > 0.2
rate, _ = np.polyfit(beside.times[late], np.log(np.abs(beside.center[late, 1])), 1)
print(f"grows {abs(beside.center[-1, 1] / beside.center[0, 1]):.0f} times in half a second, T = {1 / rate:.3f} s")
assert np.abs(on.center[:, 1]).max() < 1e-12  # [m] a crest has no side
assert np.all(beside.center[:, 1] < 0)  # to the side where it began
assert 0.06 < 1 / rate < 0.1

# %% [markdown]
# The stiffness across an equilibrium shows whether it is a saddle: one of `pftwin.equilibrium(scene).eigenvalues` is
# then negative.
#
# ## A dislocation across the edge
#
# A surface that was fitted to a part of the bone ends somewhere. Beyond its edge the patch continues along its tangent.
# A patella that is pulled sideways over the edge therefore moves smoothly, and each frame in which the button bears on
# the continuation is flagged.
#
# Left: the path of the button's centre across the groove, which overshoots and then circles the point towards which the
# tendon pulls. Right: the contact force. Filled dots are frames whose status says that a loaded contact lies beyond the
# edge. In those frames, believe only that the patella went over the edge, not the anatomy.

# %%
over = default["dislocation_across_the_edge"]
beyond = (over.flags & pftwin.Status.LEFT_PATCH) > 0
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(9.0, 3.4))
    place, load = figure.subplots(1, 2)
    y, z = 1e3 * over.center[:, 1], 1e3 * over.center[:, 2]
    contact_force = over.effects["contact"]["force"]
    for axes, across, along in ((place, y, z), (load, over.times, contact_force)):
        axes.plot(across, along, color=COLOURS[0], linewidth=1.0)
        axes.plot(across[beyond], along[beyond], "o", color=COLOURS[1], markersize=4, label="flagged: beyond the edge")
        axes.plot(
            across[~beyond], along[~beyond], "o", color=COLOURS[0], markersize=4, fillstyle="none", label="not flagged"
        )
    place.axvspan(-12, 12, color="0.9", zorder=0)
    place.annotate("fitted patch", (0, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -11),
                   textcoords="offset points", ha="center", fontsize=8)  # fmt: skip
    place.set(title="path of the button's centre", xlabel="lateral [mm]", ylabel="out of the bone [mm]")
    place.set_xlim(left=-14)
    load.set(title="contact force", xlabel="time [s]", ylabel="[N]")
    handles, labels = place.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle("dislocation_across_the_edge (invented)")
figure

# %%
print(f"{beyond.sum()} of {beyond.size} frames are flagged, the first at {over.times[np.argmax(beyond)]:.2f} s")
assert beyond.any()
assert not beyond[0]
assert np.isfinite(over.center).all()
assert y[beyond].min() > 0

# %% [markdown]
# ## Steps that are too long
#
# A contact a hundred times stiffer than usual vibrates at about 10 kHz. An explicit method in steps of 0.1 ms cannot
# follow it: the energy explodes within a few steps. The implicit method copes with steps ten times as long.
#
# What matters is that the bad simulation **says so before the first value that is not finite**. The figure shows
# kinetic energy. Crosses are frames with a flag that refuses the result; a curve ends where the values stop being
# finite. The implicit simulation comes to rest for a moment at 0.45 s, where the tibia turns back.

# %%
REFUSES = pftwin.Status.STEP_TOO_LONG | pftwin.Status.NOT_FINITE | pftwin.Status.ENERGY_FROM_NOWHERE
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(7.0, 3.2))
    axes = figure.subplots()
    for k, name in enumerate(("linear_implicit", "symplectic_euler")):
        run = ran[name]["contact_hard"]
        kinetic = np.where(np.isfinite(run.energies.kinetic), run.energies.kinetic, np.nan)
        label = f"{name}, {1e3 * run.settings['dt_s']:g} ms"
        axes.plot(run.times, np.maximum(1e3 * kinetic, 1e-6), color=COLOURS[k], marker="o", markersize=3, label=label)
        bad = (run.flags & REFUSES) > 0
        axes.plot(run.times[bad], np.maximum(1e3 * kinetic[bad], 1e-6), "x", color="black", markersize=7,
                  label="flagged: not to be trusted" if bad.any() else None)  # fmt: skip
    axes.set(yscale="log", xlabel="time [s]", ylabel="kinetic energy [mJ]")
    axes.set_title("contact_hard (invented): the lower curve is right, the upper one is flagged as wrong")
    figure.legend(loc="outside lower center", ncols=3)
figure

# %%
bad, good = ran["symplectic_euler"]["contact_hard"], default["contact_hard"]
refused = np.flatnonzero(bad.flags & REFUSES)
print(f"explicit: {said(bad)}")
print(f"implicit: {said(good)}")
lost = np.flatnonzero(~np.isfinite(bad.center).all(axis=1))
assert refused.size
assert not lost.size or refused[0] <= lost[0]
assert not good.status & REFUSES

# %% [markdown]
# ## Input that is refused
#
# The cheapest wrong simulation is the one that never starts. Impossible values are refused with a message that names
# the field, what was found, and what was expected.

# %%
refusals = {name: found for name, found in default.items() if isinstance(found, pftwin.InputError)}
for name, words in refusals.items():
    print(f"{name}\n    {words}")
assert set(refusals) == {"radius_negative", "tendon_stiffness_negative", "motion_not_finite"}
for name, words in refusals.items():
    assert hard_cases.case_named(name).expected.refusal in str(words)

# %% [markdown]
# ## What the statuses mean
#
# This table is generated from the code: every flag that a frame can have, its text, and which of the simulations above
# had it. A frame with no flag is clean ("ok"). There are three kinds of flags: what happened (no contact, the patch was
# left, the patella snapped), what to be careful about (a deep indentation, a start that is no equilibrium), and what
# not to believe (the others).

# %%
rows = []
for flag in pftwin.Status:
    had = [
        f"{name} ({integrator})"
        for integrator, runs in ran.items()
        for name, found in runs.items()
        if not isinstance(found, pftwin.InputError) and found.status & flag
    ]
    if flag:
        shown = ", ".join(had[:2]) + (f" and {len(had) - 2} more" if len(had) > 2 else "")
        rows.append([f"`{flag.name}`", flag.describe(), shown or "none of these"])
assert len(rows) == len(pftwin.Status) - (pftwin.Status.OK in list(pftwin.Status))
table(["flag", "in words", "runs above that have it"], rows)

# %% [markdown]
# `result.summary()` counts the frames with each flag, `result.flags` has them frame by frame, and every file that you
# write contains them.
#
# ## A part of the matrix
#
# Looking at curves does not scale. `pftwin hard-cases` simulates all cases with all contact models, integrators and
# floating-point types, and judges each simulation by conditions that every one must meet: values are finite, no energy
# appears from nowhere, there is no force at a distance and no missed contact (checked by an exhaustive search that
# shares no code with the simulator), flags are right, and a simulation that differs from a converged one says so. Each
# cell of the matrix **passes**, **fails**, or is **refused**: the simulation itself reports in time that it must not be
# trusted. The table below has the catalogue's scenes from above; the full matrix is in
# [docs/hard_cases.md](../docs/hard_cases.md).

# %%
JUDGED = ("linear_implicit", "linear_implicit_bdf2", "symplectic_euler")
chosen = hard_cases.Selection(
    contacts=("P5",),
    integrators=tuple(hard_cases.method_named(name) for name in JUDGED),
    dtypes=("float64",),
    derivatives=False,
    batch_independence=False,
)
cells = [c for c in hard_cases.run_matrix(cases, chosen) if c.case in NAMES]
outcome = {(c.case, c.integrator): c.outcome for c in cells}
table(["case", *JUDGED], [[name, *(outcome[name, i] for i in JUDGED)] for name in NAMES])

# %%
print(dict(tables.counts(cells)))
for c in cells:
    if c.outcome != "pass" and c.case not in refusals:
        print(f"{c.case}, {c.integrator}: {c.outcome}: {c.reason}")
assert tables.counts(cells)["fail"] == 0
assert outcome["contact_hard", "symplectic_euler"] == "refused"
assert outcome["dislocation_across_the_edge", "linear_implicit"] == "refused"  # it reports that its steps are too long

# %% [markdown]
# **In short.** Read the status before the results, and choose a method that suits the question: impacts need short
# steps. To decide what to omit from a scene and what to add, see [what effects cost and
# change](08_what_effects_are_worth.ipynb).
