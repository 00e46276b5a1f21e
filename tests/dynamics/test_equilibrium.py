"""Static equilibrium against a long, heavily damped simulation; and what the status says of a motion."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, contact, flat_patch, knee, run, settled, starting_as_it_is, vec

from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3, Wrench
from pftwin.dynamics.equilibrium import place_unknown
from pftwin.dynamics.frame_states import first_guide, frame_states, starting_equilibrium
from pftwin.dynamics.integrators import LinearImplicit, SymplecticEuler
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import System
from pftwin.dynamics.status import Status
from pftwin.model.effects.base import Effect, Instant, Load
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.damping import LinearDamping
from pftwin.studies.hard_cases.batch import built_scene
from pftwin.studies.hard_cases.case import case_named


@eqx.filter_jit
def long_damped(scene):
    """Ten seconds, heavily damped, the tibia held still."""
    damped = scene.with_effect(LinearDamping(J(3.0), J(1e-3), body="ground"))
    sys, guide = System.of(damped), first_guide(damped)
    state = sys.start(damped.center_of_mass_pose(), guide)
    return jax.lax.fori_loop(
        0, 10_000, lambda _, s: LinearImplicit().advance(sys, s, lambda _: guide, J(1e-3))[0], state
    )


def test_equilibrium_is_where_damped_motion_ends():
    scene = knee()
    solution, rest = settled(scene), long_damped(scene)
    assert bool(solution.converged())
    assert float(solution.residual) < 1e-8
    assert float(rest.velocity.norm()) < 1e-9
    apart = (solution.pose.position - rest.position).norm()
    turn = (solution.pose.orientation.conjugate() * rest.orientation).rotation_vector().norm()
    assert 1e3 * float(apart) < 1e-5
    assert float(turn) < 1e-6
    lowest = np.linalg.eigvalsh(np.asarray(solution.stiffness))[0]
    assert lowest > 0  # it is a stable one


@pytest.mark.slow
def test_equilibrium_follows_its_parameters():
    """The implicit function theorem against central differences: a stiffness, and the shape of the whole patch.

    From close by: Newton's last step then leaves far less than the tolerance, which would show in the slopes.
    """
    scene = knee()
    found = settled(scene).pose
    near = Pose(found.apply(-scene.patella.center_of_mass) + vec(1e-5, 1e-5, 1e-5), found.orientation)

    def where(s):
        return [s.effects[1].stiffness, s.effects[3].surface.coefficients]

    def pose(factor):
        k, c = where(scene)
        changed = eqx.tree_at(where, scene, [k * (1 + factor[0]), c * (1 + factor[1])])
        moved = starting_equilibrium(changed, near).pose
        return jnp.concatenate([1e3 * moved.position.array(), moved.orientation.array()])

    h, along = 1e-5, jnp.tile(jnp.eye(2), (3, 1))
    at = along * jnp.repeat(J([h, -h, 0.0]), 2)[:, None]
    values, slopes = jax.jit(jax.vmap(lambda theta, d: jax.jvp(pose, (theta,), (d,))))(at, along)
    for i in range(2):
        difference = np.asarray(values[i] - values[2 + i]) / (2 * h)
        assert np.abs(difference[:3]).max() > 1  # millimetres per unit of relative change
        np.testing.assert_allclose(slopes[4 + i], difference, rtol=1e-5, atol=1e-6 * np.abs(difference).max())


def test_several_starts_find_the_same_equilibrium():
    scene = knee()
    first = settled(scene).pose.position.array()
    rng = np.random.default_rng(0)
    for _ in range(5):
        offset, tilt = 3e-3 * rng.normal(size=3), 0.1 * rng.normal(size=3)
        start = Pose(scene.start.position + vec(*offset), Quaternion.from_rotation_vector(vec(*tilt)))
        solution = settled(eqx.tree_at(lambda s: s.start, scene, start))
        assert bool(solution.converged())
        np.testing.assert_allclose(solution.pose.position.array(), first, atol=1e-9)


class Jump(Effect):
    """A force that pushes back to a plane, as large on both sides of it."""

    force: Scalar  # [N]
    proximal: Scalar  # place of the plane [m]

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        away = now.patella.position.x - self.proximal
        push, none = -self.force * jnp.sign(away), 0.0 * away
        return Load(wrench=Wrench(Vec3(push, none, none), Vec3(none, none, none))), memory


@pytest.mark.parametrize(("force", "found"), [(1e-5, True), (0.3, False)])
def test_a_jump_of_the_load_is_an_equilibrium_where_both_sides_are_near(force, found):
    """As where a triangle passes the rim of a mesh: on either side Newton's step leads to the other one."""
    scene = knee()
    plane = settled(scene).pose.position.x + 0.4 * force / 2e3  # as if the knee gave way by 1 mm for 2 N
    solution = settled(scene.with_effect(Jump(J(force), plane, name="jump")))
    assert bool(solution.converged()) == found
    if found:
        assert float(solution.residual) > 1e-6
        assert abs(float(solution.pose.position.x - plane)) < 1e-7
        assert 0 < place_unknown(solution) < 1e-6


def flags(scene, start=None) -> Status:
    """All flags of all frames of a motion."""
    seen = run(scene, starting_as_it_is(scene) if start is None else start)[1]
    out = Status.OK
    for s in np.unique(np.asarray(seen.status)):
        out |= Status(int(s))
    return out


@eqx.filter_jit
def slope_of_pose(scene, k):
    """By the quadriceps' stiffness."""
    return jax.jvp(lambda k: starting_equilibrium(scene.set("quadriceps.stiffness", k)).pose, (k,), (jnp.ones(()),))[1]


@pytest.mark.parametrize("change", [1e-2, -1e-2])  # of 629 N/m
def test_a_search_beside_the_equilibrium_does_not_end_before_it_moves(change):
    """While memories are refined the pose stays, and so does the residual: that is neither a jump nor rounding."""
    scene = built_scene(case_named("tendon_stiff"), "P5")
    rest = settled(scene)
    k = scene.effect("quadriceps").stiffness
    near = Pose(rest.pose.apply(-scene.patella.center_of_mass), rest.pose.orientation)
    found = settled(eqx.tree_at(lambda s: s.start, scene.set("quadriceps.stiffness", k + change), near))
    slope = slope_of_pose(scene, k)
    assert float(found.residual) < 1e-8
    assert float(found.rounding) < 1e-8
    moved = (found.pose.position - rest.pose.position).array()
    np.testing.assert_allclose(moved, change * slope.position.array(), rtol=1e-3, atol=1e-14)


def test_a_clean_motion_is_ok():
    scene = knee()
    status = flags(scene, settled(scene))
    assert status == Status.OK
    assert status.describe() == "ok"


@pytest.mark.slow
def test_a_button_in_the_air_touches_nothing():
    scene = knee()
    away = eqx.tree_at(lambda s: s.effects[0].acceleration, scene, vec(0, 0, 300.0))
    assert Status.NO_CONTACT in flags(away)


@pytest.mark.slow
def test_beyond_the_patch_is_said():
    scene = knee()
    small = eqx.tree_at(lambda s: s.effects[3].surface.half_size, scene, (J(0.024), J(0.001)))
    status = flags(small)
    assert Status.LEFT_PATCH in status
    assert "outside the fitted surface" in status.describe()


def test_a_soft_contact_sinks_in():
    scene = knee()
    soft = eqx.tree_at(lambda s: s.effects[3].law.contact_stiffness, scene, J(1e5))
    assert Status.DEEP_INDENTATION in flags(soft)


def test_a_start_out_of_balance_is_said():
    scene = knee()
    start = eqx.tree_at(lambda s: s.residual, settled(scene), J(0.5))
    assert flags(scene, start) == Status.START_NOT_IN_EQUILIBRIUM


@pytest.mark.slow
def test_a_step_too_large_is_not_finite_and_says_so():
    """Explicit steps of 10 ms on a tendon of 1e9 N/m."""
    scene = knee(101)
    stiff = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, J(1e9)).without("contact")
    stiff = stiff.with_effect(contact(Hertz(J(1e12)), flat_patch()))

    def look(scene, start):
        path = frame_states(scene, start=start, substeps=1, integrator=SymplecticEuler())
        return observe(scene, path).status

    status = np.asarray(eqx.filter_jit(look)(stiff, starting_as_it_is(stiff)))
    assert int(status[-1]) & int(Status.NOT_FINITE)
    assert not int(status[0]) & int(Status.NOT_FINITE)


def test_a_step_that_is_too_long_is_said_to_be():
    """Turning by 0.4 rad, or moving by half the button's radius, within one step."""
    scene = knee()
    path = run(scene, settled(scene))[0]
    look = eqx.filter_jit(lambda path: observe(scene, path).status)

    def flagged(path) -> np.ndarray:
        return (np.asarray(look(path)) & int(Status.STEP_TOO_LONG)) != 0

    assert not flagged(path).any()
    assert flagged(eqx.tree_at(lambda p: (p.states.spin.x, p.step), path, (path.states.spin.x + 40, J(1e-2)))).all()
    assert flagged(
        eqx.tree_at(lambda p: (p.states.velocity.z, p.step), path, (path.states.velocity.z - 1, J(1e-2)))
    ).all()
