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
# # Quick start
#
# This notebook simulates a knee whose patella dislocates, treats it, and compares the two. It takes about a minute. You
# will get:
#
# 1. a simulation of a recorded motion of seven seconds, plotted against knee flexion;
# 2. a comparison with measurements;
# 3. the same knee with its tibial tuberosity moved 16 mm medially, which prevents the dislocation;
# 4. files for other programs: NetCDF, pandas, and a web page with the moving knee;
# 5. a derivative of the simulation, and sixty variants in one batch.
#
# The knee is case 2 of the virtual rig that comes with pftwin. **All its data are synthetic**: a second model, which
# differs from the one used here, generated the motion and the measurements. Nothing here is about a patient.

# %%
# %matplotlib inline
import jax
import matplotlib.pyplot as plt
import numpy as np

import fitting
import pftwin

plt.rcParams["figure.dpi"] = 68  # small files

# %% [markdown]
# ## Simulate
#
# A **scene** contains the patella, everything that acts on it, and the recorded motion of femur and tibia. The
# simulation starts from the static equilibrium and follows the recorded motion. `tolerance` limits the error of the
# patella's path.

# %%
scene = pftwin.rig.case(2, contact="P5")  # a knee of your own: pftwin.load_scene("knee/scene.toml")
print("what acts on the patella:", ", ".join(effect.name for effect in scene.effects))
result = pftwin.simulate(scene, tolerance="0.05 mm")
print(result.summary())
assert scene.synthetic
assert result.equilibrium.converged

# %% [markdown]
# The summary first answers the clinical question: the patella dislocates laterally as the knee straightens. It then
# counts the frames whose estimated error is too large to trust, and those in which the button has left the surface that
# was fitted to the trochlea.

# %%
assert result.dislocations().re_engaged is False  # it left the groove, and did not come back within the recording
result.plot.against_flexion()

# %% [markdown]
# ## Compare with measurements
#
# The virtual rig recorded forces and the patella's path (synthetic). `validate` computes the rows of Table 1 of Michaud
# et al. (2024); the figure shows where the differences are.

# %%
measured = pftwin.rig.measured(2)
rows = pftwin.validate(result, measured).to_rows()
assert measured.synthetic
print("against synthetic measurements")
for row in rows:
    print(f"{row.label:28s} {row.value:8.3g} {row.unit}")

# %%
result.plot.compared(measured)

# %% [markdown]
# ## Treat
#
# A treatment is a function from a scene to a scene. This one moves the tibial tuberosity, where the patellar tendon is
# attached, 16 mm medially.

# %%
treated = fitting.treatments.tibial_tuberosity_transfer(scene, medialisation=0.016)
after = pftwin.simulate(treated, tolerance="0.05 mm")
print(f"untreated: {result.dislocations().describe()}")
print(f"treated:   {after.dislocations().describe()}")
assert result.dislocations().events
assert not after.dislocations().events

# %%
pftwin.results.plots.against_flexion({"untreated": result, "16 mm medially": after}, strokes="together")

# %%
after.plot.trajectory()

# %% [markdown]
# ## Export
#
# A result is an xarray Dataset. Every variable has a unit and a long name. You can convert it to a pandas table, a
# NetCDF file, a CSV file or an OpenSim storage file. `result.view("knee.html")` (extra `viewer`) writes the moving knee
# as one page that opens offline.

# %%
after.save("after.nc")
after.to_csv("after.csv")
frame = after.to_dataset()[["knee_flexion", "patella_tilt", "patella_rotation", "contact_force"]].to_dataframe()
frame.iloc[::120].round(2)

# %% [markdown]
# ## Differentiate and batch
#
# The whole simulation is a pure function of the scene's parameters, so JAX can differentiate it. How much does the
# button's most lateral position change when the tuberosity moves one millimetre farther?


# %%
def lateral(medialisation: jax.Array) -> jax.Array:
    """The button's most lateral position in the femur [mm] for a medial transfer of the tuberosity [mm]."""
    moved = fitting.treatments.tibial_tuberosity_transfer(scene, medialisation=1e-3 * medialisation)
    return 1e3 * pftwin.trajectory(moved, integrator=pftwin.BDF2(), dt=2.5e-3).shift.max()


value, slope = jax.jvp(lateral, (16.0,), (1.0,))
print(f"16 mm medially: most lateral position {float(value):.2f} mm, changes by {float(slope):.3f} mm per mm")
assert np.isclose(float(value), 1e3 * after.shift.max(), atol=0.1)
assert slope < 0

# %% [markdown]
# JAX can also map the function: the next cell simulates sixty transfers in one compiled program. The derivative above
# is the slope of this curve at 16 mm. The step in the curve is where the patella begins to stay in its groove.

# %%
amounts = np.linspace(0.0, 20.0, 60)
curve = jax.jit(jax.vmap(lateral))(amounts)
with plt.rc_context(pftwin.plots.STYLE):
    figure, axes = plt.subplots(figsize=(6.5, 3.2), dpi=80)
    axes.plot(amounts, curve, ".-", color=pftwin.plots.COLOURS[0], label="60 simulations in one batch")
    near = np.array([14.0, 18.0])
    tangent = float(value) + float(slope) * (near - 16)
    axes.plot(near, tangent, color=pftwin.plots.COLOURS[1], linewidth=3, alpha=0.6, label="derivative at 16 mm")
    axes.set(xlabel="medialisation of the tuberosity [mm]", ylabel="most lateral position [mm]")
    axes.set_title("Case 2 of the virtual rig (synthetic)")
    axes.legend()
assert np.isfinite(curve).all()
assert curve[0] > 2 * curve[-1]
assert np.isclose(np.interp(17.0, amounts, curve) - np.interp(15.0, amounts, curve), 2 * float(slope), rtol=0.3)

# %% [markdown]
# ## Where next
#
# - [What accuracy costs in time](02_accuracy.ipynb): which integrator and time step to choose.
# - [Fit tendon stiffness from motion](03_fit_tendons.ipynb), with its uncertainty.
# - [Predict and optimise a treatment](04_treatment.ipynb).
# - [Bring your own knee](05_your_own_knee.ipynb).
# - [Hard cases](06_hard_cases.ipynb) and what the statuses mean.
# - [Your own effect](07_your_own_effect.ipynb).
# - [What effects cost and change](08_what_effects_are_worth.ipynb).
