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
# # Bring your own knee
#
# This notebook goes from a laboratory's files to a simulated patella with fitted tendons. You will get:
#
# 1. a scene file and a laboratory's files (markers, forces, mesh of the implant), as `pftwin init` writes them; replace
#    them with yours;
# 2. a check of the recording before any simulation: gaps, residuals;
# 3. a contact surface fitted to the mesh, and the error of that fit;
# 4. the simulation compared with the measurements, and a fit of the tendons;
# 5. the messages for common mistakes, which name the file, the line and the field;
# 6. if you have its data, a real implant: the knee of subject DM.
#
# The example's files are those of case 1 of the virtual rig: **motion, forces and markers are synthetic**, and every
# figure says so.

# %%
# %matplotlib inline
import os
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

import fitting
import pftwin
from pftwin.files.mocap import cluster_poses, find_gaps, read_trc
from pftwin.files.scene_file import load_scene_file
from pftwin.geometry import fit_patch, load_mesh, trochlear_region
from pftwin.results.plots import COLOURS, STYLE
from pftwin.results.plots.region import plot_region
from pftwin.rig import geometry
from pftwin.rig.scene_template import write_example

pftwin.configure(cache_dir=True)  # double precision and fast code, kept for the next time
mpl.rcParams["figure.dpi"] = 72  # small files

# %% [markdown]
# ## A laboratory's files
#
# `pftwin init knee` writes the same files from the command line.

# %%
temporary = tempfile.TemporaryDirectory()  # removed when the notebook ends
folder = Path(temporary.name) / "knee"
for path in write_example(folder, case=1):
    print(f"{path.relative_to(folder.parent)}  {path.stat().st_size / 1e3:.0f} kB")
text = (folder / "scene.toml").read_text()
print("\n" + "\n".join(text.splitlines()[:40]))

# %% [markdown]
# ## Check the recording first
#
# A hidden marker is missing, not zero. The markers of a rigid segment keep their distances, so the residual of a rigid
# fit to each cluster shows how good the recording is.

# %%
markers = read_trc(next(folder.glob("*.trc")))
names = list(markers.names)
print(f"{len(names)} markers, {markers.times.size} frames, {len(find_gaps(markers))} gaps")
for body, cluster in (("tibia", geometry.TIBIA_MARKERS), ("patella", geometry.PATELLA_MARKERS)):
    own = [names.index(n) for n in cluster]
    poses = cluster_poses(markers.positions[:, own], list(cluster.values()), markers.times, names=list(cluster))
    print(f"{body}: rms residual of its {len(own)} markers at most {1e3 * poses.residual_rms.max():.2f} mm")
    assert poses.residual_rms.max() < 2e-3

# %% [markdown]
# ## A contact surface
#
# pftwin finds the trochlea on the mesh and fits a polynomial patch to it. The patch is smooth, and contact with it is
# fast to compute. Each line below states the error in shape.

# %%
mesh = load_mesh(folder / "femoral_component.stl", units="m")
region = trochlear_region(mesh, anterior=[0, 0, 1], proximal=[1, 0, 0])
fits = [fit_patch(mesh, degree=degree, region=region) for degree in ("P2", "P4", "P5", "P8")]
print("\n".join(str(fit) for fit in fits))
assert all(a.rms > b.rms for a, b in pairwise(fits))

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(5.2, 4.4), dpi=64)
    plot_region(region, mesh, figure.subplots())
figure

# %% [markdown]
# ## Simulate and compare
#
# The scene file names all inputs. `load_scene_file` filters the markers, computes the frames, fits the surface, and
# reads the measurements. Its notes state what it decided itself.

# %%
loaded = load_scene_file(folder / "scene.toml")
print("\n".join(note.replace(str(folder), "knee") for note in loaded.notes))
result = pftwin.simulate(loaded.scene, tolerance="0.05 mm")
print(result.summary())
assert loaded.scene.synthetic
assert loaded.measured.synthetic
assert not result.dislocations().events

# %%
result.plot.compared(loaded.measured)

# %% [markdown]
# ## Fit the tendons
#
# The fit estimates stiffness and slack length of both tendons from the motion and one force. [Notebook
# 3](03_fit_tendons.ipynb) explains it.

# %%
estimate = fitting.fit_tendons(loaded.scene, loaded.measured, use=("position", "quadriceps"), starts=8)
print(estimate.summary())
before = pftwin.validate(result, loaded.measured).mean_distance
after = pftwin.validate(pftwin.simulate(estimate.scene, tolerance="0.05 mm"), loaded.measured).mean_distance
print(f"mean distance from the synthetic measurements: {before:.2f} mm before, {after:.2f} mm after")
assert after < before

# %% [markdown]
# ## Mistakes and their messages
#
# pftwin does not guess silently, and an input error does not end in a traceback from deep inside the code. Here are
# four common mistakes:

# %%
MISTAKES = {
    "a forgotten unit": ("stiffness_N_per_m", "stiffness"),
    "an impossible number": ("mass_kg = ", "mass_kg = -"),
    "a marker that the file lacks": (f"{next(iter(geometry.TIBIA_MARKERS))} = [", "KNEE9 = ["),
    "a missing file": ("femoral_component.stl", "femoral_component_v2.stl"),
}
for what, (right, wrong) in MISTAKES.items():
    (folder / "mistake.toml").write_text(text.replace(right, wrong, 1))
    try:
        pftwin.load_scene(folder / "mistake.toml")
    except pftwin.InputError as error:
        print(f"{what}:\n  {str(error).replace(str(folder), 'knee')}\n")
    else:
        raise AssertionError(f"{what}: accepted")

# %% [markdown]
# ## A real implant
#
# This is the knee of subject DM of the sixth Grand Challenge competition, as published with OpenSim JAM: an
# instrumented total knee replacement whose passive flexion JAM simulated. The geometry is real; the motion is
# simulated, not measured. `examples/dm_knee.py` reads it, as [Bring your own knee](../docs/bring_your_own_knee.md)
# explains step by step. Its data are not part of pftwin: this cell runs if the variable PFTWIN_DATA names their folder.

# %%
data = os.environ.get("PFTWIN_DATA")
if data is None:
    print("the data of the DM knee are not available here")
else:
    sys.path.append(str(Path(pftwin.__file__).resolve().parents[1] / "examples"))
    import dm_knee

    dm, simulated, compared = dm_knee.run(Path(data) / "dm_knee", dt=5e-3)
    print(f"mean distance of the button's centre from the recording: {1e3 * compared.mean_distance:.2f} mm")
    assert compared.mean_distance < 2.5e-3

# %%
if data is not None:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.0), dpi=80)
        left, right = figure.subplots(1, 2)
        flexion = np.degrees(simulated.knee.flexion)
        for k, axis in enumerate(("proximal", "lateral", "anterior")):
            left.plot(flexion, 1e3 * compared.offset[:, k], color=COLOURS[k], label=axis)
        left.set(xlabel="knee flexion [deg]", ylabel="simulated minus recorded [mm]", title="Button's centre")
        left.legend()
        for k, name in enumerate(("simulated", "required by the recorded tensions")):
            right.plot(flexion, compared.force[:, k], color=COLOURS[k], label=name)
        right.set(xlabel="knee flexion [deg]", ylabel="contact force [N]", title="Contact force")
        right.legend()
        figure.suptitle("DM knee: real implant, recording simulated by OpenSim JAM")
    display(figure)

# %% [markdown]
# ## Where next
#
# The [worked patient](../docs/worked_knees.md) fits two tendons to that simulated recording and compares the forces
# with the recorded ones. "Scene files, field by field" on the documentation site lists all that a scene can contain:
# ligaments of many strands, toe regions, friction, meshes. `pftwin doctor-mesh femur.stl` reports defects of a mesh.
# `pftwin import model.osim` starts from an OpenSim model.
