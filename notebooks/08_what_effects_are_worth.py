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
# # What effects cost and change
#
# Friction, inertia, damping, toe regions: every effect takes computing time and needs parameters, and some do not
# change the result. For a knee of the virtual rig, this notebook shows:
#
# 1. what each effect **costs** (`explain`): operations, share of the time, stiffness, energy;
# 2. what each effect **changes** (`audit`): how far the patella's path moves when you omit it, or add it.
#
# The rig's motion is **synthetic**: this is about the method, not about a patient. Statements about figures are
# followed by an `assert`; times are shown but never checked.

# %%
# %matplotlib inline
import matplotlib as mpl
from IPython.display import Markdown
from matplotlib.figure import Figure

import pftwin
from pftwin.results.plots import COLOURS, STYLE
from pftwin.studies.audit.audit import audit
from pftwin.studies.audit.explain import explain
from pftwin.studies.audit.report import audit_figure, audit_sheet, explanation_sheet

pftwin.configure(cache_dir=True)  # double precision and fast code, kept for the next time

# %% [markdown]
# ## What effects cost
#
# Case 2 of the virtual rig (synthetic) has weight, two tendons, contact, and a drag on the patella. Its patella
# dislocates. `explain` reports for each effect how many equations it adds to a time step, what share of the step's time
# it takes, whether it is stiff, and how much energy it exchanged with the patella.

# %%
knee = pftwin.rig.case(2, contact="P5")
explained = explain(knee)
Markdown(explanation_sheet(explained).markdown())

# %%
work = sum(part.work for part in explained.parts if part.of is None)
print(f"work adds up to {1e3 * work:.2f} mJ, kinetic energy changed by {1e3 * explained.kinetic_change:.2f} mJ")
assert abs(explained.energy_gap) < 1e-3  # [J] of some 3 J of absolute work
assert [part.name for part in explained.parts if part.stiff] == ["contact"]
assert max(explained.parts, key=lambda part: part.equations).name == "contact"

# %% [markdown]
# Only the contact is stiff: it alone would force an explicit method to take steps of less than a tenth of a
# millisecond. Its search for the nearest points also makes up most of the computation.
#
# Times are less certain than the ± suggests, probably because the compiler does not always optimise the compared
# programs alike. This notebook was run five times, on busy machines, and the last run is shown. In two of the others
# one tendon had a share of -32 or -56 %, and in a third friction, below, took 86 % more time. Repeat the measurement
# if a time looks wrong.

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(7.0, 2.4))
    axes = figure.subplots()
    parts = [part for part in explained.parts if part.of is None]
    axes.barh([part.name for part in parts], [part.equations for part in parts], color=COLOURS[0])
    axes.invert_yaxis()
    axes.set(xlabel="equations per step that it adds", title="Case 2 of the virtual rig (synthetic): what effects add")
figure

# %% [markdown]
# ## What effects change
#
# `audit` simulates the scene without an effect, or with one that it lacks, and compares the two. To save time, this
# cell chooses some rows; `audit(knee)` or `pftwin audit --case 2` computes all of them
# ([docs/audit.md](../docs/audit.md)).

# %%
ROWS = (
    "damping",
    "tendons' damping",
    "friction",
    "patella inertia x 2",
    "patella inertia x 1/2",
    "steps half as long",
)
weighed = audit(knee, only=ROWS)
Markdown(audit_sheet(weighed).markdown())

# %% [markdown]
# The panels show how far the button's path moves, how much the contact force changes, and the computing time of the
# change. Bars are rms over the motion, and thin lines extend to the largest value. Note the logarithmic axes. The
# dashed line is the tolerance: you can omit an effect whose largest change is below it. The grey bar is the yardstick:
# the change when the step is halved. Ignore changes smaller than that.

# %%
audit_figure(weighed, "Case 2 of the virtual rig (synthetic): what each effect changes")

# %% [markdown]
# The scene has no friction. Adding it would move the path by 4 mm rms, more than any other row here, so this scene's
# results hold for a joint that slides freely. Omitting the drag moves the path by up to two centimetres where the
# patella dislocates. Doubling the patella's inertia moves it by two millimetres there: the knee moves slowly, so
# inertia matters little.

# %%
worth = {row.name: row for row in weighed.rows}
largest = {name: 1e3 * row.changes.center_max for name, row in worth.items()}
print({name: round(value, 3) for name, value in largest.items()}, "mm at most")
assert set(worth) == set(ROWS)
yardstick = largest.pop("steps half as long")
assert yardstick < 0.1 < min(largest.values())  # steps are short enough, and every one of these matters
typical = {name: 1e3 * row.changes.center_rms for name, row in worth.items()}
assert max(typical, key=typical.get) == "friction"
assert 3 < typical["friction"] < 6
assert 16 < largest["damping"] < 30
assert largest["patella inertia x 2"] < 3
assert "dislocation" in weighed.tracking

# %% [markdown]
# **In short.** Omit effects that change less than your tolerance, and add those that change more. Use `pftwin explain
# scene.toml` and `pftwin audit scene.toml --out audit` for your own knee.
