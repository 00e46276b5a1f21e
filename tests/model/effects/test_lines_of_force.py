"""Tendons, strands and prescribed tensions: pull by so much and expect so much; slack is nothing at all."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, knee_motion, look, tendon, vec

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.model.effects.tendon import StrandGroup, Tendon
from pftwin.model.effects.tension import PrescribedTension

# A tendon of 500 N/m and 50 mm slack length that runs straight up to z = 100 mm.


def load_of(effect, position, velocity=(0, 0, 0), time: Any = 0.0) -> Any:
    """By one program for all places and times: numbers that are no arrays would be compiled in."""
    return _load_of(effect, *(jnp.asarray(x, dtype=float) for x in (*position, *velocity, time)))


@eqx.filter_jit
def _load_of(effect, x, y, z, along_x, along_y, along_z, time):
    now = look()
    then = Vec3(x, y, z), Vec3(along_x, along_y, along_z), time
    return effect.load(eqx.tree_at(lambda n: (n.patella.position, n.patella.velocity, n.time), now, then), None)[0]


def pull(load) -> float:
    return float(jnp.sum(load.stiff[0].force))


def test_ten_millimetres_beyond_slack():
    load = load_of(tendon(k=500), (0, 0, 0.04))
    assert pull(load) == pytest.approx(500 * 0.01)
    assert float(load.total().force.z) == pytest.approx(500 * 0.01)
    assert float(load.energy) == pytest.approx(0.5 * 500 * 0.01**2)


def test_stretching_faster_pulls_harder():
    load = load_of(tendon(k=500, c=5.0), (0, 0, 0.04), (0.3, 0, -0.2))
    assert pull(load) == pytest.approx(500 * 0.01 + 5 * 0.2)
    assert float(load.dissipation()) == pytest.approx(5 * 0.2**2)


@pytest.mark.parametrize("velocity", [(0, 0, 0), (0, 0, -1), (1, 2, 3)])
def test_slack_is_nothing_in_value_and_gradient(velocity):
    at = (J(500.0), J(0.05), J(5.0), J(0.06))
    value, slopes = everything_and_slopes(*at, jnp.asarray(velocity, dtype=float))
    assert float(value) == 0
    assert [float(g) for g in slopes] == [0, 0, 0, 0]


@jax.jit
def everything_and_slopes(k, slack, c, z, velocity):
    def everything(k, slack, c, z):
        load = load_of(eqx.tree_at(lambda t: (t.stiffness, t.slack_length, t.damping), tendon(), (k, slack, c)),
                       (0.0, 0.0, z), velocity)  # fmt: skip
        w = load.total()
        return load.energy + sum(jnp.square(x) for x in jax.tree.leaves(w)) + jnp.sum(load.stiff[0].force)

    return jax.value_and_grad(everything, (0, 1, 2, 3))(k, slack, c, z)


def test_a_tendon_without_length_is_harmless():
    def force(z, slack):
        return load_of(eqx.tree_at(lambda t: t.slack_length, tendon(c=5.0), slack), (0.0, 0.0, z)).total().force.array()

    jacobian = jax.jit(jax.jacrev(force, (0, 1)))
    for slack in (0.05, 1e-6):
        assert np.all(np.isfinite(load_of(tendon(slack=slack), (0, 0, 0.1)).total().force.array()))
        assert all(np.all(np.isfinite(g)) for g in jacobian(J(0.1), J(slack)))


def test_it_never_pushes_and_lets_go_when_it_shortens_fast():
    quick = load_of(tendon(k=500, c=5.0), (0, 0, 0.04), (0, 0, 1.2))  # 5 N elastic less 6 N viscous
    assert pull(quick) == 0
    assert float(quick.dissipation()) == pytest.approx(500 * 0.01 * 1.2)  # what the spring gives back is lost


def group(rng) -> tuple[Tendon, list[Tendon]]:
    n = 4
    k, slack = J(rng.uniform(1e2, 1e3, n)), J(rng.uniform(0.03, 0.2, n))
    here, there = (Vec3.from_array(J(rng.normal(scale=0.1, size=(n, 3)))) for _ in range(2))
    together = Tendon(k, slack, 0.01 * k, here, there, "tibia", name="group")
    return together, [jax.tree.map(lambda a, i=i: a[i], together) for i in range(n)]


def test_a_line_says_how_many_it_is_and_whether_it_can_stay():
    """A line to the ground has no place where the femur is held still: the ground would move."""
    single, segment = tendon(body="tibia"), knee_motion(4).tibia
    assert (single.count, group(np.random.default_rng(0))[0].count) == (None, 4)
    assert single.line_element() is single
    assert single.in_still_femur(segment) is single
    assert tendon(body="ground").in_still_femur(segment) is None


class Band(Tendon):
    """A tendon that shows its strain, and nothing else."""

    def observe(self, now, memory):
        return {"strain": self.line(now).length / self.slack_length - 1}


def test_a_tendon_that_shows_something_else_shows_that_and_stores_as_much():
    fields = {f.name: getattr(tendon(k=500), f.name) for f in dataclasses.fields(Tendon)}
    now = look((0, 0, 0.04))
    shown, energy = eqx.filter_jit(lambda e: e.report(now, None))(Band(**fields))
    assert float(shown.pop("strain")) == pytest.approx(0.2)
    assert not shown
    assert float(energy) == pytest.approx(0.5 * 500 * 0.01**2)


def test_a_group_is_the_sum_of_its_tendons():
    together, singles = group(np.random.default_rng(0))
    where = (0.01, -0.02, 0.03), (0.1, 0.2, -0.3)
    whole, parts = load_of(together, *where), [load_of(s, *where) for s in singles]
    assert 0 < sum(pull(p) > 0 for p in parts) < 4  # some taut, some slack
    for of in (lambda x: x.total().force.array(), lambda x: x.total().moment.array(), lambda x: x.energy):
        np.testing.assert_allclose(of(whole), sum(of(p) for p in parts), atol=1e-12)


@pytest.mark.parametrize("which", ["tendon", "strands"])
def test_force_and_moment_are_the_gradient_of_energy(which):
    together, _ = group(np.random.default_rng(1))
    if which == "strands":
        like = jnp.ones_like(together.stiffness)
        together = StrandGroup(together.stiffness, together.slack_length, 0.5 * like, 0 * like, together.insertion,
                               together.origin, "tibia", name="strands")  # fmt: skip

    def energy_and_wrench(d) -> Any:
        turn = Quaternion.from_rotation_vector(Vec3(d[3], d[4], d[5]))
        load = together.load(_at(d, turn), None)[0]
        return load.energy, load.total()

    slope, wrench = jax.jit(jax.grad(energy_and_wrench, has_aux=True))(jnp.zeros(6))
    np.testing.assert_allclose(-slope[:3], wrench.force.array(), rtol=1e-10)
    np.testing.assert_allclose(-slope[3:], wrench.moment.array(), rtol=1e-10)


def _at(d, turn):
    now = look()
    return eqx.tree_at(lambda n: (n.patella.position, n.patella.rotation), now, (Vec3(*d[:3]), turn.rotation()))


# Strands: 1000 N per unit strain, 80 mm long when slack, toe region to 6 % strain; straight up to z = 100 mm.
SLACK, TOE, STIFFNESS = 0.08, 0.06, 1000.0


def strands(damping_time=0.0) -> StrandGroup:
    one = jnp.ones(1)
    up = jax.tree.map(lambda a: a[None], vec(0, 0, 0.1))
    at = jax.tree.map(lambda a: a[None], vec(0, 0, 0))
    return StrandGroup(STIFFNESS * one, SLACK * one, TOE * one, damping_time * one, at, up, "tibia", name="strands")


def at_strain(e: float) -> tuple[float, float, float]:
    return 0.0, 0.0, 0.1 - SLACK * (1 + e)


def test_strands_after_blankevoort():
    e1 = TOE / 2
    for e, expected in ((-0.1, 0), (0.02, STIFFNESS * 0.02**2 / (4 * e1)), (0.1, STIFFNESS * (0.1 - e1))):
        assert pull(load_of(strands(), at_strain(e))) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("edge", [0.0, TOE])
def test_strands_are_smooth_where_the_toe_region_begins_and_ends(edge):
    below, above = (load_of(strands(), at_strain(edge + d)).stiff[0] for d in (-1e-9, 1e-9))
    assert float(above.force[0] - below.force[0]) == pytest.approx(0, abs=1e-4 * STIFFNESS * TOE)
    assert float(above.stiffness[0] - below.stiffness[0]) == pytest.approx(0, abs=1e-6 * STIFFNESS / SLACK)


def test_strand_energy_is_the_work_of_its_pull():
    e = np.linspace(0, 0.12, 4001)  # across the edge of the toe region
    loads: Any = eqx.filter_jit(jax.vmap(lambda z: load_of(strands(), (0.0, 0.0, z))))(J(0.1 - SLACK * (1 + e)))
    force, energy = loads.stiff[0].force[:, 0], loads.energy
    assert float(np.trapezoid(force, SLACK * e)) == pytest.approx(float(energy[-1]), rel=1e-6)
    slope = np.gradient(np.asarray(force), SLACK * e)
    np.testing.assert_allclose(slope[1:-1], loads.stiff[0].stiffness[1:-1, 0], atol=1e-3 * STIFFNESS / SLACK)


def test_strand_damping_per_strain_rate():
    load = load_of(strands(damping_time=0.01), at_strain(0.1), (0, 0, -0.4))
    assert pull(load) == pytest.approx(STIFFNESS * (0.1 - 0.03 + 0.01 * 0.4 / SLACK))
    assert pull(load_of(strands(damping_time=0.01), at_strain(-0.01), (0, 0, -0.4))) == 0


def test_prescribed_tension_between_before_and_after_its_samples():
    origin = Vec3(J([[0.0], [0.3], [0.0]]), jnp.zeros((3, 1)), J([[0.4], [0.4], [0.4]]))
    at = jax.tree.map(lambda a: a[None], vec(0, 0, 0))
    line = PrescribedTension(J([[10.0], [20.0], [50.0]]), origin, at, 1.0, 0.5, "tibia", name="muscle")
    for time, size, x in ((0.2, 10, 0), (1.0, 10, 0), (1.25, 15, 0.15), (1.75, 35, 0.15), (2.0, 50, 0), (9.0, 50, 0)):
        w = load_of(line, (0, 0, 0), time=J(time)).total()
        np.testing.assert_allclose(w.force.array(), size * np.array([x, 0, 0.4]) / np.hypot(x, 0.4), atol=1e-12)


def test_a_moved_origin_is_where_it_was_and_the_move():
    one = tendon(k=500)
    moved = one.with_origin_moved(vec(0.001, -0.002, 0.003))
    np.testing.assert_allclose(moved.origin.array() - one.origin.array(), [0.001, -0.002, 0.003], atol=1e-15)
    np.testing.assert_array_equal(moved.insertion.array(), one.insertion.array())
