"""What a scene does not hold is not in its program: equations are counted in the traced program."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, contact, flat_patch, knee, traced_as_it_is

from pftwin.dynamics.frame_states import first_guide, frame_states
from pftwin.dynamics.state import System
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.model.effects.contact_law import Flores, Hertz
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene


def equations(jaxpr) -> int:
    """Of a program, those inside its loops and calls included."""
    total = 0
    for eqn in jaxpr.eqns:
        inner = [
            getattr(x, "jaxpr", x) for v in eqn.params.values() for x in (v if isinstance(v, (tuple, list)) else (v,))
        ]
        total += 1 + sum(equations(x) for x in inner if hasattr(x, "eqns"))
    return total


def program(scene: Scene):
    """The traced motion, without the search for the start."""
    arrays, static = eqx.partition(scene, eqx.is_array)

    def move(arrays):
        scene = eqx.combine(arrays, static)
        return frame_states(scene, start=traced_as_it_is(scene)).states.position

    return jax.make_jaxpr(move)(arrays).jaxpr


def size(scene: Scene) -> int:
    return equations(program(scene))


@pytest.fixture(scope="module")
def whole() -> int:
    return size(knee(5))


@pytest.mark.parametrize("absent", ["gravity", "quadriceps", "patellar_tendon", "contact"])
def test_an_absent_effect_leaves_no_equation(absent, whole):
    assert size(knee(5).without(absent)) < whole


def test_an_effect_more_is_equations_more(whole):
    assert size(knee(5).with_effect(LinearDamping(J(0.1), J(1e-4)))) > whole


def test_nothing_is_left_of_contact_where_there_is_none(whole):
    """Not a surface, not a fan, not a search."""
    scene = knee(5)
    bare = size(scene.without("contact"))
    assert bare < 0.5 * whole
    assert scene.contact is not None
    patch = scene.contact.surface
    assert isinstance(patch, PolynomialPatch)
    coefficients = len(patch.coefficients)
    assert str(program(scene)).count(f"f64[{coefficients}]") > 0
    assert str(program(scene.without("contact"))).count(f"f64[{coefficients}]") == 0


def test_a_fixed_femur_costs_nothing(whole):
    scene = knee(5)
    t = scene.motion.times
    upright = PoseSeries(t, np.zeros((t.size, 3)), np.tile([1.0, 0, 0, 0], (t.size, 1)))
    fixed, moving = (
        size(Scene(scene.patella, scene.effects, KneeMotion.from_poses(femur, upright), scene.start))
        for femur in (None, upright)
    )
    assert fixed == whole
    assert moving > whole


def test_memory_is_there_only_for_laws_that_remember():
    def memory(law):
        scene = knee(5).with_effect(contact(law, flat_patch()))
        pose = scene.center_of_mass_pose()
        state = jax.eval_shape(lambda: System.of(scene).start(pose, first_guide(scene)))
        return state.memories[scene.index("contact")]

    assert memory(Hertz(J(2e8))).approach_speeds is None
    remembered = memory(Flores(J(2e8), J(0.6)))
    assert len(jax.tree.leaves(remembered)) == len(jax.tree.leaves(memory(Hertz(J(2e8))))) + 2


def test_parameters_are_leaves_and_never_structure():
    """Another stiffness is the same program; another effect is not."""
    scene = knee(5)
    other = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, J(999.0))
    assert jax.tree.structure(other) == jax.tree.structure(scene)
    assert jax.tree.structure(scene.without("gravity")) != jax.tree.structure(scene)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(eqx.filter(scene, eqx.is_array)))


def test_numbers_of_pythons_own_weak_type_will_do():
    """As `jnp.asarray(0.1)` makes them; the tests' other scenes are of strong ones, as files and the rig are."""

    def weak(a):
        return jnp.asarray(float(a)) if eqx.is_inexact_array(a) and a.ndim == 0 else a

    scene = jax.tree.map(weak, knee(5))
    assert scene.effect("quadriceps").stiffness.weak_type
    assert not knee(5).effect("quadriceps").stiffness.weak_type
    ends = [v.aval for v in program(scene).outvars]
    assert [(a.shape, a.dtype, a.weak_type) for a in ends] == [((5,), jnp.dtype(float), False)] * 3
