"""Layers between a button and a plate in equilibrium and in motion: balance, rest, energy, gradients, batches."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pressed_button import ARM, DOME, MASS, disc, pressed
from scenes import J, run, starting_as_it_is
from scipy.optimize import brentq

from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.simulate import equilibrium, simulate
from pftwin.dynamics.status import Status
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.foundation_law import LogarithmicFoundation
from pftwin.model.scene import Scene

FLAT, DOMED = disc(0.0), disc(1 / DOME)
G = 9.81
FALL = 61  # frames, in which it comes to rest


def pull(depth: float) -> float:
    """Weight and both tendons, straight down, with the button's apex so deep in the plate [N]."""
    length = np.hypot(ARM, 0.066 - depth)
    return MASS * G + 2 * 2e3 * (length - 0.05) * (0.066 - depth) / length


def alone(mesh: SurfaceMesh, **more) -> Scene:
    """Without what pulls to the side; of one number of frames, so that all share their programs."""
    return pressed(mesh, n_frames=FALL, **more).without("across")


@pytest.mark.slow
def test_a_flat_button_is_as_deep_as_its_layers_ask_for():
    scene = alone(FLAT)
    report = equilibrium(scene)
    stiffness = FLAT.area / float(scene.effect("contact").law.compliance())
    depth = brentq(lambda d: stiffness * d - pull(d), 0.0, 1e-3, xtol=1e-15)
    shown = report.effects["contact"]
    assert report.converged
    assert not report.relaxed
    assert report.kind == "stable" or report.kind == "neutral"
    assert shown["indentation"] == pytest.approx(depth, rel=1e-9)
    assert shown["force_z"] == pytest.approx(pull(depth), abs=1e-6)
    assert shown["mean_pressure"] == pytest.approx(pull(depth) / FLAT.area, rel=1e-9)
    assert report.position[2] == pytest.approx(-depth, abs=1e-12)


@pytest.mark.slow
def test_a_logarithmic_layer_is_as_deep_as_its_law_asks_for():
    scene = alone(FLAT, modulus=2e6)
    law = scene.effect("contact").law
    stiff = eqx.tree_at(lambda s: s.effects[-1].law, scene, LogarithmicFoundation(law.femur, law.button))
    shown = equilibrium(stiff).effects["contact"]
    k, h = float(law.femur.confined_modulus()), 3e-3  # two layers alike: each bears -k ln(1 - d / 2 h)
    depth = brentq(lambda d: -k * np.log1p(-d / (2 * h)) * FLAT.area - pull(d), 0.0, 5.9e-3, xtol=1e-15)
    assert depth > 5e-4
    assert shown["indentation"] == pytest.approx(depth, rel=1e-9)


@pytest.mark.slow
def test_a_dome_is_as_deep_as_the_volume_it_displaces():
    scene = alone(DOMED)
    shown = equilibrium(scene).effects["contact"]
    k = 1 / float(scene.effect("contact").law.compliance())
    depth = brentq(lambda d: k * np.pi * d**2 * (DOME - d / 3) - pull(d), 0.0, 2e-3)
    assert shown["indentation"] == pytest.approx(depth, rel=0.05)  # of its centroids: the apex is no centroid
    assert shown["force_z"] == pytest.approx(pull(depth), rel=0.01)
    assert shown["area"] == pytest.approx(2 * np.pi * DOME * depth, rel=0.1)


@pytest.fixture(scope="module")
def fallen():
    """A dome let go half a millimetre above where it touches; its tibia pulls at nothing."""
    still = alone(DOMED, height=0.5e-3)
    return still, run(still, starting_as_it_is(still), J(10))


@pytest.mark.slow
def test_a_damped_fall_ends_in_the_equilibrium(fallen):
    scene, (path, shown) = fallen
    report = equilibrium(scene)
    assert np.asarray(shown.effects["contact"]["force"])[0] == 0
    assert np.asarray(shown.status)[0] == Status.NO_CONTACT
    end = np.array([float(getattr(shown.patella.position, k)[-1]) for k in "xyz"])
    np.testing.assert_allclose(end, report.position, atol=1e-7)
    assert float(path.states.velocity.norm()[-1]) < 1e-5
    assert float(shown.effects["contact"]["force"][-1]) == pytest.approx(report.effects["contact"]["force_z"], rel=1e-3)


@pytest.mark.slow
def test_what_the_fall_loses_is_accounted_for(fallen):
    scene, _ = fallen
    gaps, lost = [], 0.0
    for substeps in (10, 80):
        path, shown = run(scene, starting_as_it_is(scene), J(substeps))
        total = shown.kinetic_energy + sum(shown.potential_energy.values(), start=jnp.zeros(()))
        taken = path.ledger.numerical_dissipation(shown.kinetic_energy)
        gap = total - total[0] - path.ledger.work + path.ledger.heat + taken
        gaps.append(float(jnp.abs(gap[-1])))
        lost = float(path.ledger.heat[-1])
    assert lost > 1e-3  # joules: two tendons let go over a millimetre
    assert gaps[-1] < 0.02 * lost
    assert gaps[-1] < 0.2 * gaps[0]


@pytest.mark.slow
def test_a_run_from_equilibrium_is_clean_and_keeps_its_budget():
    result = simulate(pressed(DOMED))
    assert result.status == Status.OK
    assert result.contact == "contact"
    assert np.ptp(result.center[:, 1]) > 1e-4  # the tibia pulls it aside
    assert np.nanmax(np.abs(result.energies.budget_error)) < 0.01 * np.abs(result.energies.work).max()
    assert result.largest_indentation == pytest.approx(np.nanmax(result.effects["contact"]["indentation"]))


def softened(scene: Scene, modulus) -> Scene:
    return eqx.tree_at(lambda s: s.effects[s.index("contact")].law.button.modulus, scene, modulus)


def end(scene: Scene, modulus) -> jax.Array:
    """Where the patella is in the last frame [m]."""
    path = frame_states(softened(scene, modulus), substeps=J(10), start=starting_equilibrium(softened(scene, modulus)))
    states = path.states
    return (states.position - states.orientation.rotate(scene.patella.center_of_mass)).array()[-1]


MODULUS = 8e6
STEP = 1e-3 * MODULUS
MODULI = (MODULUS - STEP, MODULUS + STEP, 2 * MODULUS)


@pytest.mark.slow
def test_a_batch_is_its_members():
    scene = pressed(DOMED)
    ends = np.stack(
        [simulate(softened(scene, J(m)), integrator=LinearImplicit(), dt=1e-3).position[-1] for m in MODULI]
    )
    batch = jax.jit(jax.vmap(lambda m: end(scene, m)))(J(MODULI))
    np.testing.assert_allclose(batch, ends, rtol=0, atol=1e-12)
    assert np.linalg.norm(ends[2] - ends[0]) > 1e-5


@pytest.fixture(scope="module")
def short():
    return pressed(DOMED, n_frames=11)


@pytest.mark.slow
def test_the_end_follows_a_layers_modulus(short):
    one = jax.jit(lambda m: end(short, m))
    ends = [np.asarray(one(J(m))) for m in MODULI]
    slope = np.asarray(jax.jit(jax.jacfwd(lambda m: end(short, m)))(J(MODULUS)))
    differences = (ends[1] - ends[0]) / (2 * STEP)
    assert np.linalg.norm(slope) * MODULUS > 1e-5
    np.testing.assert_allclose(slope, differences, rtol=2e-3, atol=2e-3 * np.linalg.norm(slope))


@pytest.mark.slow
def test_the_reverse_mode_agrees_with_the_forward(short):
    def last(m):
        state = starting_equilibrium(short)
        path = frame_states(softened(short, m), substeps=10, start=jax.lax.stop_gradient(state))
        return path.states.position.z[-1]

    backward = jax.jit(jax.grad(last))(J(MODULUS))
    forward = jax.jit(jax.jacfwd(last))(J(MODULUS))
    np.testing.assert_allclose(backward, forward, rtol=1e-8)


@pytest.mark.slow
def test_an_equilibrium_follows_a_layers_modulus():
    scene = pressed(DOMED)

    def height(m):
        return starting_equilibrium(softened(scene, m)).pose.position.z

    slope = jax.jit(jax.jacfwd(height))(J(MODULUS))
    depths = [equilibrium(softened(scene, J(m))).position[2] for m in (0.999 * MODULUS, 1.001 * MODULUS)]
    assert float(slope) == pytest.approx((depths[1] - depths[0]) / (0.002 * MODULUS), rel=2e-3)
    assert float(slope) > 0  # a stiffer layer gives way less
