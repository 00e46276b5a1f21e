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
# # Only the effects that a scene calls for
#
# Friction, inertia, damping, toe regions: every effect takes time and wants parameters, and some change nothing. You
# will get, for a knee of the virtual rig:
#
# 1. what each effect **costs** (`explain`): operations, share of the time, stiffness, energy moved;
# 2. what each is **worth** (`audit`): how far the patella's path moves when it is left out, or put in.
#
# The rig's motion is **synthetic**: this is about the method, not about a patient. Statements about figures are
# followed by an `assert`; times are shown but never checked.

# %%
# %matplotlib inline
import matplotlib as mpl
from IPython.display import Markdown
from matplotlib.figure import Figure

import pftwin
from pftwin.base.runtime import default_cache_dir
from pftwin.results.plots import COLOURS, STYLE
from pftwin.studies.audit.audit import audit
from pftwin.studies.audit.explain import explain
from pftwin.studies.audit.report import audit_figure, audit_sheet, explanation_sheet

pftwin.configure(cache_dir=default_cache_dir())  # double precision and fast code, kept for the next time

# %% [markdown]
# ## What it costs
#
# A model can have too little in it, and too much. Case 2 of the virtual rig (synthetic) has weight, two tendons,
# contact and a drag on the patella; it dislocates. `explain` says what each of them **costs**: how many equations it
# adds to a step and what share of a step's time goes with it, whether it is stiff, and the energy that it moved.

# %%
knee = pftwin.rig.case(2, contact="P5")
explained = explain(knee)
Markdown(explanation_sheet(explained).markdown())

# %%
work = sum(part.work for part in explained.parts if part.of is None)
print(f"works add up to {1e3 * work:.2f} mJ, kinetic energy changed by {1e3 * explained.kinetic_change:.2f} mJ")
assert abs(explained.energy_gap) < 1e-3  # [J] of some 3 J moved
assert [part.name for part in explained.parts if part.stiff] == ["contact"]
assert max(explained.parts, key=lambda part: part.equations).name == "contact"

# %% [markdown]
# Only the contact is stiff: an explicit method would have to take steps of less than a tenth of a millisecond because
# of it alone. Its search for the nearest points is also most of the work.

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(7.0, 2.4))
    axes = figure.subplots()
    parts = [part for part in explained.parts if part.of is None]
    axes.barh([part.name for part in parts], [part.equations for part in parts], color=COLOURS[0])
    axes.invert_yaxis()
    axes.set(
        xlabel="operations of a step that go with it", title="Case 2 of the virtual rig (synthetic): what effects add"
    )
figure

# %% [markdown]
# ## What it is worth
#
# `audit` says what an effect is **worth**: it runs the scene without it, or with one that it lacks, and compares.
# Some rows are chosen here, to save time; `audit(knee)` or `pftwin audit --case 2` makes all of them
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
# The bars: how far the button's path moves (bar: rms over the motion; thin line: to the largest), how much the
# contact force changes, and the time that the change takes. Note the logarithmic axes. The dashed line is the
# tolerance below which an effect could go. The grey bar is the yardstick: what a step half as long changes. Bars
# shorter than it say nothing.

# %%
audit_figure(weighed, "Case 2 of the virtual rig (synthetic): what each effect is worth")

# %% [markdown]
# Friction, which the scene does not have, would move the path by 4 mm rms, more than any other row here: so this
# scene's figures hold for a joint that slides freely. The drag is worth two centimetres where the patella dislocates. A
# patella twice as heavy to accelerate moves it by two millimetres there: the knee moves slowly, and inertia matters
# little.

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
# **In short.** Leave out what the audit says is worth less than your tolerance, and put in what it says is worth more.
# `pftwin explain scene.toml` and `pftwin audit scene.toml --out audit` do it for a knee of your own.
