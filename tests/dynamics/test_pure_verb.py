"""The pure verb: what a user who has read the README and nothing else does with it."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import hanging_scene, small_scene, vec

import pftwin
from pftwin.dynamics import simulate as simulate_module
from pftwin.dynamics.frame_states import start_before_search
from pftwin.geometry.patch.fit import fit_patch
from pftwin.geometry.patch.implant import rig_implant
from pftwin.geometry.patch.region import region_about
from pftwin.model.scene import Scene
from pftwin.rig.contacts import implant_mesh

STEP = 2.5e-3  # [s]


@pytest.fixture(scope="module")
def small() -> Scene:
    return small_scene(11)


@pytest.fixture(scope="module")
def hung() -> Scene:
    return hanging_scene(11)


@pytest.fixture(scope="module")
def rig() -> Scene:
    """On a patch that ends at 30 deg, beyond whose edge its button rests near extension."""
    mesh, angles = implant_mesh(), (np.radians(-75.0), np.radians(30.0))
    region = region_about(mesh, rig_implant().chart, angles=angles, half_width=0.02)
    scene = pftwin.rig.case(1, contact="P5")
    short = fit_patch(mesh, degree="P5", region=region).patch
    return scene.with_effect(scene.effect("contact").with_fitted_surface(short))


def moved(scene: Scene) -> pftwin.Trajectory:
    return pftwin.trajectory(scene, integrator=pftwin.BDF2(), dt=5e-3)


def test_it_is_what_simulate_gives() -> None:
    scene = small_scene()  # of the length that many tests simulate: the programs are theirs
    path = pftwin.trajectory(scene, integrator=pftwin.LinearImplicit(), dt=5e-3, energy_budget=True)
    result = pftwin.simulate(scene, integrator=pftwin.LinearImplicit(), dt=5e-3)
    close = {"rtol": 1e-9, "atol": 1e-12}
    for name in ("times", "shift", "contact_force_medial", "contact_force_lateral"):
        np.testing.assert_allclose(getattr(path, name), getattr(result, name), **close)
    for name in ("center", "position", "contact_force"):
        np.testing.assert_allclose(getattr(path, name).array(), getattr(result, name), **close)
    for kind in ("angles", "knee"):
        np.testing.assert_allclose(getattr(path, kind), getattr(result, kind), **close)
    np.testing.assert_allclose(path.tensions["quadriceps"], result.tensions["quadriceps"], **close)
    np.testing.assert_allclose(path.lengths["patellar_tendon"], result.lengths["patellar_tendon"], **close)
    np.testing.assert_allclose(path.kinetic_energy, result.energies.kinetic, **close)
    np.testing.assert_allclose(path.work, result.energies.work, **close)
    np.testing.assert_allclose(path.heat, result.energies.heat, **close)
    taken = result.energies.numerical_dissipation
    np.testing.assert_allclose(path.numerical_dissipation, taken, **close)
    np.testing.assert_array_equal(path.flags, result.flags)
    fields = {f for f in dir(path) if not f.startswith("_")} - {"units", "patella", "effects", "flags"}
    assert fields == set(path.units)


NAMES = ("quadriceps.stiffness", "patellar_tendon.slack_length", "contact.radius")


@pytest.mark.parametrize("touching", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_readmes_three_lines(small: Scene, hung: Scene, touching: bool) -> None:
    """One program each for the path, its reverse and its forward derivatives, and, touching, the mapped path."""
    small = small if touching else hung

    def force(scene: Scene) -> jax.Array:
        path = moved(scene)
        return path.contact_force.norm().max() if touching else path.tensions["quadriceps"].max()

    assert moved(small).center.x.shape == (11,)
    names = NAMES if touching else NAMES[:2]
    slope = jax.grad(force)(small)
    assert isinstance(slope, Scene)

    def scaled(shares: jax.Array) -> jax.Array:
        scene = small
        for i, name in enumerate(names):
            scene = scene.set(name, small.get(name) * shares[i])
        return force(scene)

    forward = jax.jit(lambda direction: jax.jvp(scaled, (jnp.ones(3),), (direction,))[1])
    for i, name in enumerate(names):
        nominal, h = small.get(name), 1e-5
        up, down = (force(small.set(name, nominal * (1 + d))) for d in (h, -h))
        finite = float(up - down) / (2 * h)
        assert float(nominal * slope.get(name)) == pytest.approx(finite, rel=2e-4), name
        assert float(forward(jnp.eye(3)[i])) == pytest.approx(finite, rel=2e-4), name

    if not touching:
        return
    stiffnesses = jnp.array([140.0, 156.0, 170.0])
    mapped = jax.vmap(lambda k: moved(small.set("quadriceps.stiffness", k)).shift.max())(stiffnesses)
    each = [moved(small.set("K1", float(k))).shift.max() for k in stiffnesses]
    np.testing.assert_allclose(mapped, each, rtol=1e-6)


@pytest.mark.slow
def test_without_contact_nothing_depends_on_its_parameters(small: Scene) -> None:
    """A slack patella far from the femur falls: no force, no derivative, and none that is not finite."""
    high = eqx.tree_at(lambda s: s.start.position, small, vec(-0.005, 0.001, 0.5))
    high = high.set("quadriceps.slack_length", 1.0).set("patellar_tendon.slack_length", 1.0)

    def fallen(stiffness: jax.Array) -> jax.Array:
        free = high.set("contact.law.contact_stiffness", stiffness)
        return pftwin.trajectory(free, dt=5e-3, start=start_before_search(free)).contact_force.norm().sum()

    assert float(jax.grad(fallen)(jnp.asarray(2e8))) == 0.0


@pytest.mark.parametrize("transform", [jax.jit, jax.grad, jax.vmap])
def test_simulate_refuses_a_traced_scene_before_it_compiles(small: Scene, transform, monkeypatch) -> None:
    def fails(*_: object) -> None:
        raise AssertionError("something was compiled")

    monkeypatch.setattr(simulate_module, "check", fails)
    k = jnp.asarray([150.0, 160.0]) if transform is jax.vmap else jnp.asarray(150.0)
    for verb in (pftwin.simulate, pftwin.equilibrium):
        with pytest.raises(pftwin.InputError, match=r"inside jit, grad, vmap.*try: pftwin.trajectory\(scene\)"):
            transform(lambda k, verb=verb: verb(small.set("K1", k)))(k)


@pytest.mark.parametrize("verb", [pftwin.simulate, pftwin.trajectory, pftwin.equilibrium])
def test_a_path_in_the_place_of_a_scene_names_the_function_that_loads_it(verb) -> None:
    for path in ("scene.toml", Path("scene.toml")):
        with pytest.raises(pftwin.InputError) as refused:
            verb(path)
        assert str(refused.value) == (
            f'{verb.__name__}: found {path!r}; expected: a scene; try: pftwin.load_scene("scene.toml")'
        )
    with pytest.raises(pftwin.InputError, match=rf"^{verb.__name__}: found 3; expected: a scene$"):
        verb(3)


def test_a_step_that_is_no_plain_number_is_refused(small: Scene) -> None:
    for verb in (pftwin.simulate, pftwin.trajectory):
        for wrong in ("5 ms", [1e-3], -1e-3, float("nan")):
            with pytest.raises(pftwin.InputError, match=r"^dt: found .*; expected: a positive number of seconds"):
                verb(small, dt=wrong)
    with pytest.raises(pftwin.InputError, match=r"^dt: a traced value; expected: .* number of steps; try: .*static"):
        jax.jit(lambda dt: pftwin.trajectory(small, dt=dt).position)(1e-3)


def test_a_name_in_the_place_of_an_integrator_names_the_object(small: Scene) -> None:
    for verb in (pftwin.simulate, pftwin.trajectory):
        with pytest.raises(pftwin.InputError, match=r"found 'newmark:rho=0.8'.*pftwin.Newmark\(.*rho=0.8\)"):
            verb(small, integrator="newmark:rho=0.8")


@pytest.mark.slow
def test_an_integrator_of_ones_own(hung: Scene) -> None:
    """Two half steps in the place of one: what half as long steps give."""
    from dataclasses import dataclass

    @dataclass(frozen=True)
    class Halved(pftwin.Integrator):
        name = "halved"

        @property
        def order(self) -> int:
            return 1

        def advance(self, system, state, guide_at, step, ledger=None):
            once = pftwin.LinearImplicit()
            middle, ledger = once.advance(system, state, lambda part: guide_at(0.5 * part), 0.5 * step, ledger)
            return once.advance(system, middle, lambda part: guide_at(0.5 + 0.5 * part), 0.5 * step, ledger)

    halved = pftwin.simulate(hung, integrator=Halved(), dt=5e-3)
    finer = pftwin.simulate(hung, integrator=pftwin.LinearImplicit(), dt=2.5e-3)
    np.testing.assert_allclose(halved.center, finer.center, atol=1e-12)
    assert halved.settings["integrator"] == "halved"


@pytest.mark.slow
def test_derivatives_are_those_of_finite_differences_beyond_the_edge_too(rig: Scene) -> None:
    nominal = rig.get("quadriceps.stiffness")

    def path(share: jax.Array) -> jax.Array:
        softer = rig.set("quadriceps.stiffness", nominal * (1 + share))
        return pftwin.trajectory(softer, integrator=pftwin.BDF2(), dt=STEP).center.array()

    run, slope = jax.jit(path), jax.jit(lambda: jax.jvp(path, (jnp.zeros(()),), (jnp.ones(()),))[1])
    exact, h = np.asarray(slope()), 1e-6
    finite = np.asarray(run(jnp.asarray(h)) - run(jnp.asarray(-h))) / (2 * h)
    assert pftwin.simulate(rig, dt=STEP).status & pftwin.Status.LEFT_PATCH
    # The button passes places where its distance to the groove is nearly flat, and a closest point leaps there.
    off = np.abs(exact - finite).max(axis=1) / np.abs(finite).max()
    assert np.median(off) < 1e-7
    assert off.max() < 5e-5
