"""Variants leave out and add what their descriptions say."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, J, gravity, knee, knee_motion, look, tendon, vec

from pftwin.base.spatial import Pose, Quaternion, Vec3, Wrench
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrators import LinearImplicit, Newmark
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.base import Change, Effect, Load
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.scene import PatellaBody, Scene
from pftwin.studies.audit.variants import NotApplicable, Variant, ablations, additions, without_femur_inertia

SLACK, END = 0.05, 0.1


def hung(femur: PoseSeries | None = None) -> Scene:
    """A patella between tendons of the femur, and none of contact."""
    ends = (0.1, 0.0, 0.05), (-0.05, 0.08, 0.05), (-0.05, -0.08, 0.05)
    arms = (0.02, 0.0, 0.0), (-0.01, 0.015, 0.0), (-0.01, -0.015, 0.0)
    strings = (
        tendon(400.0, 0.05, 4.0, a, e, "femur", f"t{i}") for i, (a, e) in enumerate(zip(arms, ends, strict=True))
    )
    body = PatellaBody(J(MASS), vec(3e-5, 3e-5, 4e-5), vec(0, 0, 0))
    motion = knee_motion(11, femur)
    start = Pose(vec(0, 0, 0.05), Quaternion.identity())
    if motion.femur is not None:
        first = motion.femur.frames(J(motion.start_time))
        turn = Quaternion.from_rotation(first.rotation)
        start = Pose(first.point(vec(0, 0, 0.05)), turn)
    return Scene(body, (gravity(), *strings), motion, start, "hung")


def named(found: list[Variant | NotApplicable], name: str) -> Variant | NotApplicable:
    return next(v for v in found if v.name == name)


def pull(effect, length: float) -> float:
    """Of an effect between the patella's origin and a point at that height."""
    at = eqx.tree_at(
        lambda e: e.origin, effect, Vec3(*(jnp.zeros_like(effect.origin.x) + v for v in (0.0, 0.0, length)))
    )
    return float(jnp.sum(at.load(look(), None)[0].stiff[0].force))


@pytest.mark.parametrize("length", [1.035 * SLACK, 1.2 * SLACK])
def test_a_toe_region_put_in_keeps_the_linear_region(length):
    scene = hung().without("t1").without("t2").without("gravity")
    own = scene.with_effect(tendon(400.0, SLACK, 0.0, body="ground", name="t0"))
    with_toe = named(additions(own, LinearImplicit()), "toe region")
    assert isinstance(with_toe, Variant)
    np.testing.assert_allclose(pull(with_toe.scene.effects[0], length), pull(own.effects[0], length), rtol=1e-12)
    assert pull(with_toe.scene.effects[0], SLACK) > pull(own.effects[0], SLACK) == 0
    back = named(ablations(with_toe.scene), "toe region of tendons")
    assert isinstance(back, Variant)
    for a, b in zip(jax.tree.leaves(back.scene), jax.tree.leaves(own), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize("length", [1.07 * SLACK, 1.2 * SLACK])
def test_strands_lose_their_toe_alone(length):
    def two(x: float) -> jax.Array:
        return jnp.full(2, x)

    ends = Vec3(*(two(0.0) for _ in "xyz")), Vec3(two(0.0), two(0.0), two(END))
    strands = StrandGroup(two(2e3), two(SLACK), two(0.06), two(0.0), *ends, "ground", name="strands")
    scene = hung().with_effect(strands)
    linear = named(ablations(scene), "toe region of strands")
    assert isinstance(linear, Variant)
    assert linear.alike
    assert jax.tree.structure(linear.scene) == jax.tree.structure(scene)
    np.testing.assert_allclose(pull(linear.scene.effects[-1], length), pull(strands, length), rtol=1e-12)
    assert pull(linear.scene.effects[-1], 1.02 * SLACK) == 0 < pull(strands, 1.02 * SLACK)


def test_what_is_there_is_left_out_and_what_is_not_is_put_in():
    lists = {
        name: [v.name for v in f] for name, f in (("out", ablations(knee(5))), ("in", additions(knee(5), Newmark())))
    }
    assert lists["out"][:4] == ["gravity", "quadriceps", "patellar_tendon", "contact"]
    assert "tendons' damping" in lists["out"]
    assert "gravity" not in lists["in"]
    assert {"friction", "toe region", "steps half as long"} < set(lists["in"])
    rough = named(additions(knee(5), Newmark()), "friction")
    assert isinstance(rough, Variant)
    assert "contact: friction" in [v.name for v in ablations(rough.scene)]
    assert "friction" not in [v.name for v in additions(rough.scene, Newmark())]


def test_weight_put_in_points_along_the_thigh():
    added = named(additions(hung().without("gravity"), Newmark()), "gravity")
    assert isinstance(added, Variant)
    weight = added.scene.effect("gravity")
    assert isinstance(weight, Gravity)
    np.testing.assert_allclose(weight.acceleration.array(), [-9.81, 0, 0])
    assert weight.mass == MASS


def test_inertia_is_left_out_or_put_in_by_the_integrator():
    inertia = named(additions(hung(), Newmark()), "patella inertia")
    assert isinstance(inertia, Variant)
    assert (inertia.kind, inertia.integrator) == ("left out", QuasiStatic())
    inertia = named(additions(hung(), QuasiStatic()), "patella inertia")
    assert isinstance(inertia, Variant)
    assert (inertia.kind, inertia.integrator) == ("added", LinearImplicit())
    heavy = named(additions(hung(), Newmark()), "patella inertia x 2")
    assert isinstance(heavy, Variant)
    assert heavy.scene.patella.mass == 2 * MASS
    assert heavy.scene.effects[0].load(look(), None)[0].total().force.z == pytest.approx(-9.81 * MASS)


def test_what_cannot_be_says_why():
    found = named(additions(hung(), Newmark()), "friction")
    assert isinstance(found, NotApplicable)
    assert found.reason == "nothing touches"
    found = without_femur_inertia(hung())
    assert isinstance(found, NotApplicable)
    assert "stands still" in found.reason
    moving = hung(femur_series(0.0)).with_effect(tendon(name="fixed"))
    found = without_femur_inertia(moving)
    assert isinstance(found, NotApplicable)
    assert found.reason.endswith("fixed")


def femur_series(acceleration: float) -> PoseSeries:
    """A turned femur that glides, and is pulled along."""
    t = 0.01 * np.arange(11)
    turned = np.array([np.cos(0.3), 0.0, np.sin(0.3), 0.0])
    x = np.stack([0.2 * t, 0.1 + 0 * t, 0.5 * acceleration * t**2], axis=1)
    return PoseSeries(t, x, np.tile(turned, (t.size, 1)))


@eqx.filter_jit
def in_femur(scene: Scene) -> jax.Array:
    """The patella's path there (n, 3), from the equilibrium."""
    positions = frame_states(scene, substeps=4, start=starting_equilibrium(scene)).states.position
    motion = scene.motion
    if motion.femur is None:
        return positions.array()
    times = motion.start_time + motion.frame_interval * jnp.arange(motion.n_frames).astype(float)
    return motion.femur.frames(times).to_local(positions).array()


@pytest.mark.slow
def test_a_femur_that_glides_has_no_inertial_forces():
    gliding, pulled = hung(femur_series(0.0)), hung(femur_series(3.0))
    fixed = without_femur_inertia(gliding)
    assert isinstance(fixed, Variant)
    assert fixed.scene.motion.femur is None
    own = in_femur(gliding)
    np.testing.assert_allclose(in_femur(fixed.scene), own, atol=1e-10)
    assert np.abs(in_femur(pulled) - own).max() > 1e-4  # what it feels when it is pulled along
    fixed = without_femur_inertia(pulled)
    assert isinstance(fixed, Variant)
    np.testing.assert_allclose(in_femur(fixed.scene), own, atol=1e-10)  # and does not feel any more


def test_motion_keeps_its_times():
    moving = hung(femur_series(1.0))
    fixed = without_femur_inertia(moving)
    assert isinstance(fixed, Variant)
    a, b = fixed.scene.motion, moving.motion
    assert (a.start_time, a.frame_interval, a.n_frames) == (b.start_time, b.frame_interval, b.n_frames)


class Sticky(Effect):
    """An effect that no study has heard of, with one thing that it can do without, and one that it lacks."""

    grip: jax.Array
    glue: jax.Array

    def load(self, now, memory):
        return Load(wrench=Wrench(Vec3(self.grip, self.glue, 0 * self.grip), Vec3.zero())), memory

    def simplifications(self):
        return (Change("glue", eqx.tree_at(lambda e: e.glue, self, 0 * self.glue), "dry"),)

    def elaborations(self):
        return (Change("spikes", eqx.tree_at(lambda e: e.grip, self, 10 * self.grip), "ten times the grip"),)


def test_an_effect_says_itself_what_it_can_do_without_and_what_it_lacks():
    scene = hung().with_effect(Sticky(J(1.0), J(2.0), name="sole"))
    dry = named(ablations(scene), "glue")
    assert isinstance(dry, Variant)
    assert dry.alike
    assert dry.scene.effect("sole").load(look(), None)[0].total().force.y == 0
    assert dry.sentence == "sole: dry"
    spiked = named(additions(scene, Newmark()), "spikes")
    assert isinstance(spiked, Variant)
    assert spiked.scene.effect("sole").load(look(), None)[0].total().force.x == 10
