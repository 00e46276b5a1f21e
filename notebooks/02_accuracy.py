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
# # What accuracy costs in time
#
# A simulation advances in time steps. Long steps are fast and inaccurate; short steps are slow and accurate. How
# accurate also depends on the integration method. You will get:
#
# 1. a small study, run here: three integration methods with six step lengths, their errors and computing times, in one
#    figure that marks the best settings;
# 2. recommended settings, from this study and from the full one that is kept with the project;
# 3. `simulate(..., tolerance="0.05 mm")`, which chooses the step for you, and a check that it keeps the tolerance;
# 4. the errors that remain: how far the model is from measurements, beside the paper's Table 1.
#
# The knee is case 1 of the virtual rig that comes with pftwin. **Its measurements are synthetic**: another, different
# model generated them. Agreement with them shows how accurate the method is, not that it holds for a patient.
#
# Times depend on the machine and on its other work. The load printed below is the number of programs that wanted a core
# at that time; on a busy machine the curves become ragged. So no time is checked here. Errors are the same on every
# machine: every statement about an error is followed by an `assert` that stops the notebook if it is wrong.

# %%
# %matplotlib inline
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from IPython.display import Markdown
from matplotlib.figure import Figure

import pftwin
from pftwin.base.runtime import describe
from pftwin.base.sheet import short_number
from pftwin.results.metrics import PAPER_TABLE_1
from pftwin.results.plots import COLOURS, STYLE
from pftwin.studies.accuracy.measure import measure_all
from pftwin.studies.accuracy.programs import MeasuredProgram
from pftwin.studies.accuracy.table import advice, described, front, read_csv, recommended, work_precision

pftwin.configure(cache_dir=True)  # double precision and fast code, kept for the next time
scene, measured = pftwin.rig.case(1, contact="P5"), pftwin.rig.measured(1)
print(f"{scene.name}: {scene.motion.n_frames} frames, {1e3 * scene.motion.frame_interval:g} ms apart")
print(f"measurements: {'synthetic' if measured.synthetic else 'real'}")
machine = describe()
print(", ".join(f"{key}: {machine[key]}" for key in ("cpu", "cores", "load", "jax", "date")))
assert measured.synthetic

# %% [markdown]
# ## A small study
#
# `linear_implicit` evaluates the forces once per step and damps strongly. `linear_implicit_bdf2`, pftwin's default,
# costs the same and also uses the previous step, which makes it second-order. `newmark` solves each step by iteration.
# The functions called here are those behind `pftwin accuracy --case 1`.
#
# Errors are those **of the time steps alone**: the distance of the button's centre from a converged simulation of the
# *same* model, by `newmark` in steps of 0.04 ms.

# %%
METHODS = ("linear_implicit", "linear_implicit_bdf2", "newmark")
plan = [MeasuredProgram("P5", name, "float64", batch=False, gradient=False) for name in METHODS]
found = measure_all(plan, lambda contact: pftwin.rig.case(1, contact=contact), measured, tell=print)
reference = found.references["P5"]
print(f"a second method's converged run is {reference.doubt_mm:.1g} mm from the first")
assert reference.doubt_mm < 1e-3  # the yardstick is a hundred times finer than what it measures


# %%
def table(head, rows):
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return Markdown("\n".join(f"| {' | '.join(map(str, line))} |" for line in lines))


table(
    ["method", "step, ms", "error, rms, mm", "largest, mm", "contact force, rms, N", "x real time"],
    [
        [
            r.integrator,
            f"{r.step_ms:g}",
            *map(short_number, (r.position_rms_mm, r.position_max_mm, r.force_rms_n, r.real_time)),
        ]
        for r in found.rows
    ],
)

# %% [markdown]
# The figure shows error against computing time, both on logarithmic axes: lower is more accurate, farther left is
# faster. Each line is a method, and the numbers along it are its steps in milliseconds. The wide grey band is the
# front: the settings that no other setting beats in both speed and accuracy. Settings off the front waste time.

# %%
work_precision(found.rows, "Case 1 of the virtual rig (synthetic), P5: what accuracy costs")

# %% [markdown]
# How much more accurate is a step half as long? The method's order tells: with order 1 the error halves, with order 2
# it falls to a quarter. Below, the order is measured between steps of 5 and 0.5 ms. `linear_implicit_bdf2` and
# `newmark` both have nominal order 2. Contacts that open and close between two frames reduce it.

# %%
error = {(r.integrator, r.step_ms): r.position_rms_mm for r in found.rows}
order = {name: np.log10(error[name, 5.0] / error[name, 0.5]) for name in METHODS}
for name, value in order.items():
    print(f"{name:22s} measured order {value:.2f}")

assert 0.7 < order["linear_implicit"] < 1.3
assert 1.2 < order["linear_implicit_bdf2"] < 2.3
assert 1.6 < order["newmark"] < 2.4
for name in METHODS:  # and shorter steps are always better
    errors = [error[name, step] for step in (5.0, 2.0, 1.0, 0.5, 0.2)]
    assert all(a > b for a, b in pairwise(errors))
gain = error["linear_implicit", 1.0] / error["linear_implicit_bdf2", 1.0]
print(f"at 1 ms linear_implicit_bdf2 is {gain:.0f} times as exact as linear_implicit")
assert gain > 4

# %% [markdown]
# ## Recommended settings
#
# For each level of error, the table gives the fastest setting measured here whose rms error stays within it:

# %%
Markdown(advice(found.rows).grid())

# %% [markdown]
# The rms can hide errors in single frames, so always read the largest error too. In steps of 10 ms `linear_implicit`
# has an rms error of 0.15 mm and a largest error of 0.8 mm; its contact force, in the table of all settings above, is
# wrong by more than 10 N rms.

# %%
worst = {name: next(r for r in found.rows if (r.integrator, r.step_ms) == (name, 10.0)) for name in METHODS}
for name, r in worst.items():
    print(
        f"{name:22s} at 10 ms: {short_number(r.position_rms_mm)} mm rms, {short_number(r.position_max_mm)} mm at most"
    )
assert all(r.position_max_mm >= r.position_rms_mm for r in found.rows)

# %% [markdown]
# ## The full study
#
# The project keeps a larger study: more contact models, methods and floating-point types, and 64 variants of the knee
# simulated in one batch, as fitting and treatment planning do. The newest is read here. Its date and machine are stated
# in the file and in [docs/accuracy.md](../docs/accuracy.md). Compare its rows with each other, not with times on your
# machine.

# %%
folder = Path(pftwin.__file__).resolve().parents[1] / "docs" / "benchmarks"
newest = max(folder.glob("accuracy-*.csv"))
kept = read_csv(newest)
print(f"{newest.name}: {len(kept)} rows, {len({r.contact for r in kept})} contact models")
print("\n".join(line for line in newest.read_text(encoding="utf-8").splitlines() if line.startswith("#")))
Markdown(advice(kept).grid())

# %%
work_precision(kept, "Case 1 of the virtual rig (synthetic), P5: the full study", contact="P5")

# %% [markdown]
# The left panel is for one simulation, the right one for 64 in one batch. Symbols and numbers are those of the figure
# above. Further integrators appear. `quasi_static` has no inertia: its error comes from that, not from its steps, and
# does not shrink with them. `ali3p` is the paper's own formulation. `diffrax:Tsit5` chooses its steps itself.
#
# This table lists the front over all contact models, the fastest first:

# %%
best = front(kept)
table(
    ["setting", "error, rms, mm", "largest, mm", "x real time"],
    [[described(r), *map(short_number, (r.position_rms_mm, r.position_max_mm, r.real_time))] for r in best],
)

# %% [markdown]
# Two checks follow. Along the front, the error falls as the speed does, and each recommendation keeps its level. And
# the errors measured above are at most a quarter larger than those in the kept table. Errors of a simulation do not
# depend on the machine, but they do depend on the model. The table is of 2026-11-22, when the rig's fitted patches
# ended at 30 deg of extension, inside the groove.

# %%
assert all(a.position_rms_mm > b.position_rms_mm and a.real_time >= b.real_time for a, b in pairwise(best))
assert all(a.row is None or a.row.position_rms_mm <= a.level_mm for a in recommended(kept))

before = {(r.integrator, r.step_ms): r.position_rms_mm for r in kept if (r.contact, r.dtype) == ("P5", "float64")}
same = [(error[key], before[key]) for key in error if key in before and key[1] <= 5]
ratios = np.array([now / then for now, then in same])
print(f"{len(same)} settings measured both times: errors now / then from {ratios.min():.3f} to {ratios.max():.3f}")
assert len(same) >= 12
assert np.all((ratios > 0.25) & (ratios < 1.25))

# %% [markdown]
# ## Let the simulation choose
#
# With `tolerance=` you set how far the path may be from the exact one. `simulate` then finds the longest step that
# keeps it for this scene: it doubles the number of steps until the estimated error is small enough. The result's
# settings record the chosen step and the estimated error, and every file that you write contains them.

# %%
WANTED = ("0.05 mm", "0.01 mm")
runs = {wanted: pftwin.simulate(scene, tolerance=wanted) for wanted in WANTED}
result = runs["0.05 mm"]
for key, value in result.settings.items():
    print(f"{key:18s} {value}")

# %% [markdown]
# Is the estimate true? Compare it with the converged simulation. The distance is measured as in the estimate: over
# points of the patella within 20 mm of the tracked one, rms over the frames.

# %%
exact = reference.result


def distance(run):
    """Root mean square over the frames of the error of points within 20 mm of the button's centre [m]."""
    cosine = np.abs(np.sum(run.quaternion * exact.quaternion, axis=1))
    turned = 2 * np.arccos(np.minimum(cosine, 1.0))
    return float(np.sqrt(np.mean((np.linalg.norm(run.center - exact.center, axis=1) + 0.02 * turned) ** 2)))


true = {}
for wanted, run in runs.items():
    true[wanted] = distance(run)
    estimate, bound = run.settings["estimated_error_m"], run.settings["tolerance_m"]
    print(f"wanted {wanted}, estimated {1e3 * estimate:.4f} mm, true {1e3 * true[wanted]:.4f} mm")
    assert run.settings["tolerance_held"]
    assert estimate <= bound
    assert true[wanted] <= bound  # the promise
    assert true[wanted] <= 2 * estimate  # and the estimate bounds the error, within a factor of two

# %% [markdown]
# The figure shows, frame by frame, how far the button's centre is from the converged simulation, for the steps chosen
# for two tolerances. The dashed lines are the tolerances. They apply to the rms over the frames; the error in a
# single frame can be several times the rms.

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(8.0, 3.4), dpi=80)
    axes = figure.subplots()
    for k, (wanted, run) in enumerate(runs.items()):
        apart = 1e3 * np.linalg.norm(run.center - reference.result.center, axis=1)
        chosen = f"{wanted}: {run.settings['integrator']}, {1e3 * run.settings['dt_s']:g} ms"
        axes.plot(run.times[1:], apart[1:], color=COLOURS[k], label=chosen, linewidth=0.9)
        axes.axhline(1e3 * run.settings["tolerance_m"], color=COLOURS[k], linestyle="--", linewidth=1.0)
    axes.set(yscale="log", ylim=(1e-5, 0.3), xlabel="time [s]", ylabel="error [mm]")
    axes.set_title("Case 1 of the virtual rig (synthetic): error of the steps, frame by frame")
    figure.legend(loc="outside lower center", ncols=2)
figure

# %% [markdown]
# ## Errors that shorter steps do not remove
#
# How far is the simulation from measurements? The first two columns are ours, for case 1 and against the rig's
# **synthetic** measurements: the converged simulation, and the one with the tolerance of 0.05 mm. The others are the
# paper's means over its four cases, with its own rig and measurements (Michaud et al. 2024, Table 1): coarse and fine
# mesh, and polynomial patches of degree 2, 4 and 5. Use them only for a sense of size; the two rigs are not the same.

# %%
converged, quick = found.models["P5"], pftwin.validate(result, measured)
assert converged.synthetic
assert quick.synthetic
names = ("CM", "FM", "P2", "P4", "P5")


def cell(value):
    """Three digits, or whole above a hundred."""
    return "-" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


timed = ("initial_configuration", "real_time_factor")  # of our machine; the paper's stand in its column
table(
    ["", "P5, converged (synthetic)", "P5, 0.05 mm (synthetic)", *(f"paper, {n}" for n in names)],
    [
        [f"{a.label}, {a.unit}", "-" if a.key in timed else cell(a.value), cell(b.value)]
        + [cell(PAPER_TABLE_1[n][a.key]) for n in names]
        for a, b in zip(converged.to_rows("P5"), quick.to_rows("P5"), strict=True)
    ],
)

# %% [markdown]
# In the first two columns positions agree to within a few hundredths of a millimetre. The contact force, which is most
# sensitive to the steps, differs by a tenth of a newton. The remaining distance, above a millimetre, comes from the
# model: the patch is not the implant, and the rig that generated the measurements has friction, stiffening springs and
# misplaced attachments, which the twin lacks. Steps finer than those for 0.05 mm gain nothing here; a better surface or
# better springs would.

# %%
for key in ("x", "y", "z", "mean_distance"):
    assert abs(getattr(quick, key) - getattr(converged, key)) < 0.05, key  # [mm]
share = 1e3 * true["0.05 mm"] / converged.mean_distance
print(f"the steps' error is {100 * share:.1f} % of the distance from the (synthetic) measurements")
assert share < 0.1

# %% [markdown]
# **In short.** For most work use `simulate(scene, tolerance="0.05 mm")`. For a reference use
# `integrator=pftwin.Newmark()` with `dt=1e-4`. For thousands of variants choose the fastest row of the table whose
# error you can accept. `pftwin accuracy scene.toml` does the same study for your own knee.
