"""What is not in a scene is not in its step: no equation, no field of the state; and counting counts right."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from scenes import J, contact, gravity, knee, tendon, trochlea

from pftwin.base.spatial import Vec3
from pftwin.dynamics.frame_states import start_before_search, starting_state
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.state import System
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.tendon import StrandGroup, ToeTendon
from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon
from pftwin.model.scene import Scene
from pftwin.studies.audit.account import count, equations
from pftwin.studies.audit.variants import parts


@cache
def scene() -> Scene:
    return knee(5)


def bare() -> Scene:
    """Two tendons and weight."""
    return scene().without("contact")


def strands(n: int) -> StrandGroup:
    def many(x: float) -> jax.Array:
        return jnp.full(n, x)

    ends = Vec3(many(0.0), many(0.02), many(0.0)), Vec3(many(0.0), many(0.05), many(0.0))
    return StrandGroup(many(2e3), many(0.04), many(0.06), many(3e-3), *ends, "femur", name="strands")


def relaxing() -> ViscoelasticTendon:
    t = tendon(body="femur")
    return ViscoelasticTendon(
        t.stiffness, J(300.0), J(0.5), t.slack_length, t.insertion, t.origin, t.body, name="relaxing"
    )


def added() -> dict:
    t = tendon(body="femur")
    toe = ToeTendon(t.stiffness, t.slack_length, J(0.06), t.damping, t.insertion, t.origin, t.body, name="toe")
    return {
        "tendon": t,
        "toe": toe,
        "strands": strands(5),
        "relaxing": relaxing(),
        "contact": contact(Flores(J(2e8), J(0.6)), trochlea()),
    }


@pytest.mark.parametrize("name", ["tendon", "toe", "strands", "relaxing", "contact"])
def test_a_removed_effect_leaves_no_equation(name):
    before = equations(bare())
    more = bare().with_effect(added()[name])
    assert equations(more) > before
    assert equations(more.without(name)) == before


def test_a_removed_effect_leaves_the_very_same_program():
    more = bare().with_effect(added()["strands"])
    jaxprs = [jax.make_jaxpr(lambda a, s=s: _step(s, a))(J(1e-3)) for s in (bare(), more.without("strands"))]
    assert str(jaxprs[0]) == str(jaxprs[1])
    assert str(jax.make_jaxpr(lambda a: _step(more, a))(J(1e-3))) != str(jaxprs[0])


def _step(s: Scene, step: jax.Array):
    from pftwin.studies.audit.account import guide_over

    state = starting_state(s, start_before_search(s))
    piece = s.motion.between_frames(J(0))
    return LinearImplicit().advance(System.of(s), state, guide_over(piece, J(0.0), step), step, None)[0]


def test_removed_friction_leaves_no_equation():
    rough = scene().with_effect(scene().effect("contact").with_friction(Friction(J(0.1), J(1e-3))))
    smooth, whole = parts(rough)[-1], equations(rough)
    assert smooth.name == "contact: friction"
    assert equations(smooth.without) == equations(scene()) < whole


def test_the_state_has_no_field_of_what_is_absent():
    def structure(s: Scene):
        return jax.tree.structure(eqx.filter_eval_shape(lambda: starting_state(s, start_before_search(s))))

    without_memory = structure(bare())
    for effect in (added()["tendon"], added()["strands"], gravity()):
        more = bare().with_effect(effect)
        assert structure(more).num_leaves == without_memory.num_leaves  # these remember nothing
    for effect in (added()["relaxing"], added()["contact"]):
        more = bare().with_effect(effect)
        assert structure(more).num_leaves > without_memory.num_leaves
        assert structure(more.without(effect.name)) == without_memory


def test_thirty_strands_are_as_many_equations_as_two():
    two, thirty = (equations(bare().with_effect(strands(n))) for n in (2, 30))
    assert two == thirty


def test_more_of_the_same_adds_the_same():
    counts = [equations(bare())]
    more = bare()
    for name in ("a", "b"):
        more = more.with_effect(tendon(body="femur", name=name))
        counts.append(equations(more))
    first, second = counts[1] - counts[0], counts[2] - counts[1]
    assert 0.5 * first < second < 2 * first


def test_bodies_of_loops_count_once_and_what_is_unused_not_at_all():
    @jax.jit
    def inner(x):
        return x * 2 + 1

    def loop(x, n, unused=lambda y: None):
        unused(x)
        return jax.lax.fori_loop(0, n, lambda _, y: (unused(y), inner(y))[1], x)

    assert counted(inner) == 2
    assert counted(lambda x: loop(x, 50)) == counted(lambda x: loop(x, 5000)) > 2
    assert counted(lambda x: loop(x, 50, jnp.sin)) == counted(lambda x: loop(x, 50))


def counted(function) -> int:
    return count(jax.make_jaxpr(function)(1.0).jaxpr)
