"""A tendon with a toe region: force, slope and energy in closed form, C1, and a plain tendon without the toe."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, look, scalar, vec

from pftwin.model.effects.tendon import StrandGroup, Tendon, ToeTendon

K, SLACK, TOE = 2000.0, 0.05, 0.08
END = TOE * SLACK  # of the toe region: 4 mm
TOP = 0.1


def toe_tendon(toe=TOE, c=0.0) -> ToeTendon:
    return ToeTendon(*(scalar(x) for x in (K, SLACK, toe, c)), vec(0, 0, 0), vec(0, 0, TOP), "ground", name="tendon")


@eqx.filter_jit
def load_at(effect, s, velocity=0.0) -> Any:
    """Stretched by s [m], and faster by the velocity."""
    now = look()
    places = lambda n: (n.patella.position.z, n.patella.velocity.z)  # noqa: E731
    return effect.load(eqx.tree_at(places, now, (TOP - SLACK - jnp.asarray(s), -jnp.asarray(velocity))), None)[0]


@pytest.mark.parametrize(
    ("s", "force", "slope", "energy"),
    [
        (-0.01, 0.0, 0.0, 0.0),
        (0.001, K * 0.001**2 / (2 * END), K * 0.001 / END, K * 0.001**3 / (6 * END)),
        (END, K * END / 2, K, K * END**2 / 6),
        (0.010, K * (0.010 - END / 2), K, K * ((0.010 - END / 2) ** 2 / 2 + END**2 / 24)),
    ],
)
def test_force_slope_and_energy(s, force, slope, energy):
    load = load_at(toe_tendon(), s)
    (term,) = load.stiff
    assert float(term.force) == pytest.approx(force, abs=1e-9)
    assert float(load.total().force.z) == pytest.approx(force, abs=1e-9)
    assert float(term.stiffness) == pytest.approx(slope, rel=1e-9)
    assert float(load.energy) == pytest.approx(energy, abs=1e-12)


def test_energy_is_the_work_of_the_pull_and_slope_its_derivative():
    s = J(np.linspace(-0.002, 0.012, 5001))
    loads = jax.vmap(lambda x: load_at(toe_tendon(), x))(s)
    force = np.asarray(loads.stiff[0].force)
    assert float(np.trapezoid(force, s)) == pytest.approx(float(loads.energy[-1]), rel=1e-6)
    np.testing.assert_allclose(np.gradient(force, s)[1:-1], loads.stiff[0].stiffness[1:-1], atol=1e-3 * K)


@pytest.mark.parametrize("edge", [0.0, END])
def test_it_is_smooth_where_the_toe_region_begins_and_ends(edge):
    below, above = (load_at(toe_tendon(), edge + d).stiff[0] for d in (-1e-9, 1e-9))
    assert float(above.force - below.force) == pytest.approx(0, abs=1e-5)
    assert float(above.stiffness - below.stiffness) == pytest.approx(0, abs=2e-6 * K)


def test_damping_is_that_of_a_tendon_and_it_lets_go():
    load = load_at(toe_tendon(c=5.0), 0.01, 0.3)
    assert float(load.stiff[0].force) == pytest.approx(K * (0.01 - END / 2) + 5 * 0.3)
    assert float(load.dissipation()) == pytest.approx(5 * 0.3**2)
    assert float(load_at(toe_tendon(c=5.0), 0.001, -1.0).stiff[0].force) == 0
    assert float(load_at(toe_tendon(c=5.0), -0.001, 1.0).stiff[0].force) == 0


def test_as_the_toe_vanishes_it_is_a_plain_tendon():
    plain = Tendon(scalar(K), scalar(SLACK), scalar(3.0), vec(0, 0, 0), vec(0, 0, TOP), "ground", name="tendon")
    for s in (-0.004, 0.0005, 0.008):
        gaps = []
        for toe in (1e-3, 1e-4, 1e-5):
            one, two = (load_at(e, s, 0.1) for e in (plain, toe_tendon(toe, 3.0)))
            gaps.append(abs(float(one.stiff[0].force - two.stiff[0].force)))
            assert float(one.energy) == pytest.approx(float(two.energy), abs=K * abs(s) * toe * SLACK)
        np.testing.assert_allclose(gaps, K * SLACK * np.array([1e-3, 1e-4, 1e-5]) / 2 if s > 0 else 0, rtol=1e-6)


def test_it_is_one_strand_of_the_same_slope():
    """K = k / L0."""
    one = [scalar(x)[None] for x in (K * SLACK, SLACK, TOE, 0.0)]
    points = [jax.tree.map(lambda a: a[None], p) for p in (vec(0, 0, 0), vec(0, 0, TOP))]
    strand = StrandGroup(*one, *points, "ground", name="strand")
    for s in (-0.01, 0.001, 0.01):
        a, b = load_at(toe_tendon(), s), load_at(strand, s)
        assert float(a.stiff[0].force) == pytest.approx(float(b.stiff[0].force[0]), abs=1e-12)
        assert float(a.stiff[0].stiffness) == pytest.approx(float(b.stiff[0].stiffness[0]))
        assert float(a.energy) == pytest.approx(float(b.energy), abs=1e-15)


def test_gradients_are_right_and_finite_slack_or_taut():
    def force(k, slack, toe, s):
        tendon = eqx.tree_at(lambda t: (t.stiffness, t.slack_length, t.toe_strain), toe_tendon(), (k, slack, toe))
        load = load_at(tendon, s + slack - SLACK)
        return load.stiff[0].force + 1e3 * load.energy

    at = (J(K), J(SLACK), J(TOE))
    slope = jax.jit(jax.grad(force, (0, 1, 2, 3)))
    assert [float(g) for g in slope(*at, J(-0.01))] == [0, 0, 0, 0]
    for s in (0.001, 0.01):
        for i, g in enumerate(slope(*at, J(s))):
            x = [*at, J(s)]
            up, down = ([a * (1 + d) if j == i else a for j, a in enumerate(x)] for d in (1e-6, -1e-6))
            apart = float(force(*up) - force(*down)) / (2e-6 * float(x[i]))
            assert float(g) == pytest.approx(apart, rel=1e-5, abs=1e-6)
