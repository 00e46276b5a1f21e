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
# # Your own effect
#
# Everything that acts on the patella is an *effect*: a small object with parameters and a method that returns a load.
# You will get:
#
# 1. a new effect in twenty lines: a brace that presses the patella medially once it has moved too far laterally;
# 2. three checks that it is right: the force is the slope of the energy, the energy budget closes, and the scene
#    without it is unchanged;
# 3. its derivatives, without further code: how much a stiffer brace holds the patella back, compared with finite
#    differences;
# 4. sixty braces in one batch, as a map of the effect of stiffness and play.
#
# The knee is case 2 of the virtual rig, whose patella dislocates as the knee straightens. **It is synthetic**, and the
# brace is invented: this is about the method, not about braces.

# %%
# %matplotlib inline
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import pftwin
from pftwin.dynamics.batch.batched import batched
from pftwin.model.effects import (
    Effect,
    Instant,
    Load,
    Observable,
    Patella,
    Quaternion,
    Scalar,
    StiffTerm,
    Vec3,
    quantity,
)
from pftwin.model.motion import Frame
from pftwin.results.plots import COLOURS, STYLE

pftwin.configure(cache_dir=True)  # double precision and fast code, kept for the next time
scene = pftwin.rig.case(2, contact="P5")
print(pftwin.simulate(scene, tolerance="0.05 mm").summary())
assert scene.synthetic

# %% [markdown]
# ## The brace
#
# Let y be the lateral position of the patella's centre of mass in the femur, k the stiffness, and y0 the play. The
# brace presses medially with the force F and has the energy E:
#
#     F = k max(y - y0, 0)        E = k max(y - y0, 0)^2 / 2
#
# The load has one **stiff term**: a scalar force along one direction, with its slope. The slope keeps an implicit step
# stable, however stiff the brace is. Vectors are written component by component (`Vec3`), so that the compiler can fuse
# a step into one loop, alone and in batches.


# %%
class Brace(Effect):
    """F = k max(y - play, 0), medially on the centre of mass, whose lateral position in the femur is y."""

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True))  # k
    play: Scalar = eqx.field(metadata=quantity("m"))
    name: str = eqx.field(static=True, kw_only=True, default="brace")
    observables: ClassVar[dict[str, Observable]] = {"push": Observable("N", "push of the brace")}

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        patella, femur = now.patella, now.femur
        s = jnp.maximum(femur.to_local(patella.position).y - self.play, 0.0)
        velocity = femur.relative_velocity(patella.velocity, patella.position)
        medially = femur.direction(Vec3(jnp.zeros(()), -jnp.ones(()), jnp.zeros(())))
        force, slope = self.stiffness * s, jnp.where(s > 0, self.stiffness, 0.0)
        rate = -medially.dot(velocity)  # s grows as the patella moves laterally
        term = StiffTerm(medially, Vec3.zero(), force, force, slope, jnp.zeros(()), rate)
        return Load(stiff=(term,), energy=0.5 * self.stiffness * s**2), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        return {"push": self.load(now, memory)[0].stiff[0].force}


brace = Brace(jnp.asarray(2000.0), jnp.asarray(0.005))
braced = scene.with_effect(brace)

# %% [markdown]
# Every integrator can use the effect at once. It is part of the energy budget, and of what a result reports.

# %%
runs = {name: pftwin.simulate(s, tolerance="0.05 mm") for name, s in (("no brace", scene), ("braced", braced))}
for name, run in runs.items():
    print(f"{name:9s} {run.dislocations().describe()}")
push = runs["braced"].to_dataset()["brace_push"]
print(f"largest push: {float(push.max()):.0f} {push.units}")
assert runs["no brace"].dislocations().events
assert float(push.max()) > 0
assert 1e3 * runs["braced"].shift.max() < 1e3 * runs["no brace"].shift.max() - 5

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(8.0, 3.2), dpi=80)
    left, right = figure.subplots(1, 2)
    for k, (name, run) in enumerate(runs.items()):
        left.plot(np.degrees(run.knee.flexion), 1e3 * run.shift, color=COLOURS[k], label=name)
    left.axhline(1e3 * float(brace.play), color="black", linestyle=":", label="the brace's play")
    left.set(xlabel="knee flexion [deg]", ylabel="lateral shift [mm]", title="Position of the patella")
    right.plot(np.degrees(runs["braced"].knee.flexion), push, color=COLOURS[1])
    right.set(xlabel="knee flexion [deg]", ylabel="push [N]", title="Force of the brace")
    figure.suptitle("Case 2 of the virtual rig (synthetic), with an invented brace")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
figure

# %% [markdown]
# ## Is it right?
#
# **The force is the slope of the energy.** JAX differentiates the energy, and the load must agree wherever the patella
# is: free, at the edge of the play, and pressed.


# %%
def at(y: Scalar) -> Instant:
    """A patella at rest, y to the side in a femur that stands still."""
    patella = Patella.at_rest(Vec3(jnp.asarray(0.0), y, jnp.asarray(0.05)), Quaternion.identity())
    return Instant(patella, Frame.world(), Frame.world(), time=0.0, step=0.0)


for y in (-0.010, 0.004, 0.0051, 0.020):
    force = brace.load(at(jnp.asarray(y)), None)[0].stiff[0].force
    slope = jax.grad(lambda y: brace.load(at(y), None)[0].energy)(jnp.asarray(y))
    print(f"y = {1e3 * y:6.1f} mm: force {float(force):7.3f} N, slope of the energy {float(slope):7.3f} N")
    assert np.isclose(force, slope, rtol=1e-12, atol=1e-12)

# %% [markdown]
# **The energy budget closes.** Kinetic plus stored energy, minus the work of femur and tibia, plus the heat of damping
# and the energy that the time steps remove, stays at its initial value. The remaining error shrinks as the steps do.

# %%
lost = {}
for wanted in ("0.2 mm", "0.05 mm", "0.01 mm"):  # one compiled program serves all numbers of steps
    run = pftwin.simulate(braced, tolerance=wanted)
    stored = run.energies.total.max() - run.energies.total.min()
    lost[wanted] = float(np.abs(run.energies.budget_error).max() / stored)
    print(f"steps of {1e3 * run.settings['dt_s']:.3g} ms: {100 * lost[wanted]:.3f} % of the energy is unaccounted for")
assert lost["0.01 mm"] < lost["0.2 mm"]
assert lost["0.01 mm"] < 0.01

# %% [markdown]
# **An absent effect costs nothing and changes nothing.** A brace far away never touches, so the trajectory is that of
# the scene without a brace. A scene without a brace has none of its equations.

# %%
far = scene.with_effect(Brace(jnp.asarray(2000.0), jnp.asarray(1.0)))
untouched = pftwin.simulate(far, tolerance="0.05 mm")
distance = np.abs(untouched.center - runs["no brace"].center).max()
print(f"a brace that never touches: the paths differ by {distance:.1g} m")
assert distance < 1e-9
assert "brace" not in runs["no brace"].energies.stored

# %% [markdown]
# ## Derivatives
#
# You wrote no code for derivatives. They exist because the simulation is a pure function of the scene. How does the
# button's most lateral position change with the brace's stiffness and play? The exact derivatives go through every step
# of the motion; finite differences confirm them.


# %%
def most_lateral(parameters: jax.Array) -> jax.Array:
    """Most lateral position of the button's centre [m] for a stiffness [kN/m] and a play [mm]."""
    fitted = scene.with_effect(Brace(1e3 * parameters[0], 1e-3 * parameters[1]))
    return pftwin.trajectory(fitted, integrator=pftwin.BDF2(), dt=2.5e-3).shift.max()


worn = jnp.asarray([2.0, 5.0])
value, exact = jax.jit(lambda p: (most_lateral(p), jax.jacfwd(most_lateral)(p)))(worn)
farthest = jax.jit(most_lateral)
print(f"most lateral position: {1e3 * float(value):.2f} mm")
for i, (name, unit, h) in enumerate((("stiffness", "kN/m", 1e-3), ("play", "mm", 1e-3))):
    step = jnp.zeros(2).at[i].set(h)
    finite = (farthest(worn + step) - farthest(worn - step)) / (2 * h)
    print(f"{name:9s} {1e3 * float(exact[i]):8.4f} mm per {unit}; finite differences {1e3 * float(finite):8.4f}")
    assert np.isclose(exact[i], finite, rtol=1e-3)
assert exact[0] < 0 < exact[1]  # stiffer holds it back, more play lets it go

# %% [markdown]
# ## Sixty braces at once
#
# Parameters are leaves of the scene's pytree, so `vmap` simulates many braces in one compiled program. The map shows
# how far laterally the patella moves with each brace, and how hard the brace must push.

# %%
stiffnesses, plays = np.geomspace(200, 20_000, 10), np.linspace(0.0, 0.020, 6)
grid = jnp.asarray([(k, y) for k in stiffnesses for y in plays])


@jax.jit
@batched
def outcome(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The button's most lateral position [m], and the brace's largest push [N]."""
    fitted = scene.with_effect(Brace(parameters[0], parameters[1]))
    path = pftwin.trajectory(fitted, integrator=pftwin.BDF2(), dt=2.5e-3)
    return path.shift.max(), path.effects["brace"]["push"].max()


lateral, pushes = (np.asarray(a).reshape(len(stiffnesses), len(plays)) for a in outcome(grid))
assert np.isfinite(lateral).all()
tracks = lateral[:, :-1] < 0.020
assert np.all(np.diff(lateral, axis=1)[tracks] > -1e-6)  # more play: never farther medially, as long as it tracks

# %%
with mpl.rc_context(STYLE):
    figure = Figure(figsize=(8.0, 3.4), dpi=80)
    for axes, values, label in zip(
        figure.subplots(1, 2), (1e3 * lateral, pushes), ("most lateral position [mm]", "largest push [N]"), strict=True
    ):
        drawn = axes.contourf(1e3 * plays, stiffnesses / 1e3, values, levels=8, cmap="cividis")
        axes.set(yscale="log", xlabel="play [mm]", ylabel="stiffness [kN/m]")
        axes.grid(False)
        figure.colorbar(drawn, ax=axes, label=label)
    figure.suptitle("Case 2 of the virtual rig (synthetic): what an invented brace would do")
figure

# %% [markdown]
# ## Where next
#
# [Effects, and how to add one](../docs/effects.md) has the rules for an effect that becomes part of pftwin: points of
# the patella, many similar elements as one effect, memory, a table in scene files. [What effects cost and
# change](08_what_effects_are_worth.ipynb) shows how `audit` reports what each effect changes.
