"""Each treatment changes what its name says, by the distance it says, and its derivative is right."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from scenes import J

from fitting.treatments import (
    KINDS,
    Treatment,
    deepening_shape,
    femoral_component_rotation,
    femoral_component_translation,
    lateral_release,
    mpfl_graft,
    tibial_tuberosity_transfer,
    trochleoplasty,
)
from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.scene import Scene
from pftwin.results.tracking import groove_line


def strands(name: str, y: float) -> StrandGroup:
    two = jnp.ones(2)
    origin = Vec3(J([0.01, 0.015]), y * two, -0.005 * two)
    insertion = Vec3(J([0.0, 0.01]), 0.4 * y * two, -0.005 * two)
    return StrandGroup(900 * two, 0.03 * two, 0.06 * two, 0.001 * two, insertion, origin, "femur", name=name)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A small knee with strands to either side and a groove of degree 5."""
    return scenes.knee(11).with_effect(strands("mpfl", -0.045)).with_effect(strands("lpfl", 0.045))


def xyz(v: Vec3) -> np.ndarray:
    return 1e3 * np.stack([np.asarray(a) for a in (v.x, v.y, v.z)], axis=-1)


def test_tuberosity_moves_medially_forward_and_down(scene):
    treated = tibial_tuberosity_transfer(scene, medialisation=0.010, anteriorisation=0.005, distalisation=0.003)
    tendon = "patellar_tendon"
    moved = xyz(treated.effect(tendon).origin) - xyz(scene.effect(tendon).origin)
    np.testing.assert_allclose(moved, [-3, -10, 5], atol=1e-12)
    assert float(treated.effect(tendon).slack_length) == float(scene.effect(tendon).slack_length)


def test_case_1_is_case_2_with_its_tuberosity_16_mm_medial():
    treated = tibial_tuberosity_transfer(rig.case(2), medialisation=0.016)
    np.testing.assert_allclose(
        xyz(treated.effect("patellar_tendon").origin), xyz(rig.case(1).effect("patellar_tendon").origin), atol=1e-12
    )


@pytest.mark.parametrize(
    ("kind", "tendon"), [("patellar_tendon_length_change", "patellar_tendon"), ("quadriceps_lengthening", "quadriceps")]
)
def test_lengthening_adds_to_the_slack_length(scene, kind, tendon):
    treated = Treatment.of(kind, lengthening=-0.004)(scene)
    change = float(treated.effect(tendon).slack_length - scene.effect(tendon).slack_length)
    assert 1e3 * change == pytest.approx(-4)


def test_button_moves_on_the_patella(scene):
    treated = Treatment.of("button_position", medialisation=0.002, distalisation=-0.001, anteriorisation=0.0005)(scene)
    np.testing.assert_allclose(xyz(treated.contact.center) - xyz(scene.contact.center), [1, -2, 0.5], atol=1e-12)


def test_strands_are_released_and_grafted(scene):
    half = lateral_release(scene, 0.5).effect("lpfl")
    np.testing.assert_allclose(half.stiffness, 450, rtol=1e-5)
    assert float(jnp.max(lateral_release(scene, 1.0).effect("lpfl").stiffness)) < 0.01
    graft = mpfl_graft(scene, 1.0, 0.002, proximalisation=0.006, anteriorisation=0.003).effect("mpfl")
    np.testing.assert_allclose(graft.stiffness, 1800)
    np.testing.assert_allclose(1e3 * graft.slack_length, 28)
    np.testing.assert_allclose(xyz(graft.origin) - xyz(scene.effect("mpfl").origin), [[6, 0, 3]] * 2, atol=1e-12)


@pytest.fixture(scope="module")
def case() -> Scene:
    return rig.case(2)


def heights(scene: Scene, u, v) -> np.ndarray:
    """By numpy's own polynomials, at points on the patch [mm]."""
    p = scene.contact.surface
    a, b = ((x - float(m)) / float(h) for x, m, h in zip((u, v), p.center, p.half_size, strict=True))
    table = np.zeros((p.degree + 1, p.degree + 1))
    at = [(i, j) for j in range(p.degree + 1) for i in range(p.degree + 1 - j)]
    for (i, j), c in zip(at, np.asarray(p.coefficients), strict=True):
        table[i, j] = c
    return 1e3 * np.polynomial.polynomial.polyval2d(a, b, table)


def test_trochleoplasty_deepens_the_groove_and_leaves_the_ridges(case):
    treated = trochleoplasty(case, 0.003)
    line = groove_line(case.contact.surface)
    lowered = heights(case, line.u, line.v) - heights(treated, line.u, line.v)
    np.testing.assert_allclose(lowered, 3, atol=0.06)
    assert lowered.mean() == pytest.approx(3)
    p = case.contact.surface
    for side in (-1, 1):  # at the patch's edges: less than a third of what is taken at the bottom
        edge = np.full_like(line.u, float(p.center[1]) + side * float(p.half_size[1]))
        assert np.abs(heights(case, line.u, edge) - heights(treated, line.u, edge)).max() < 1.0
    deeper = groove_line(treated.contact.surface)
    assert np.abs(np.interp(line.u, deeper.u, deeper.v) - line.v).max() < 3e-4
    assert 1e3 * np.median(deeper.depth - np.interp(deeper.u, line.u, line.depth)) == pytest.approx(3, abs=0.6)


def test_trochleoplasty_is_linear_in_the_depth(case):
    one, two = (trochleoplasty(case, d).contact.surface.coefficients for d in (0.001, 0.002))
    none = case.contact.surface.coefficients
    np.testing.assert_allclose(np.asarray(two - none), 2 * np.asarray(one - none), atol=1e-15)


@pytest.mark.parametrize("chart", ["plane", "cylinder"])
def test_component_turns_and_moves_with_all_its_points(chart):
    case = rig.case(1, chart=chart)
    u, v = J(0.004), J(0.009)

    def point(scene: Scene) -> np.ndarray:
        surface = scene.contact.surface
        return xyz(surface.chart.point(u, v, surface.height(u, v)))

    a = np.radians(6)
    # Anterior turns laterally: about x proximal, y lateral, z anterior, that is from z towards y.
    out = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    turned = femoral_component_rotation(case, external_rotation=a)
    np.testing.assert_allclose(point(turned), out @ point(case), atol=1e-9)
    assert (out @ [0, 0, 1.0])[1] > 0
    # Its front turns distally; its distal end medially.
    flexed = femoral_component_rotation(case, flexion=a).contact.surface.chart.axes
    np.testing.assert_allclose(
        np.asarray(flexed.array()),
        np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        @ np.asarray(case.contact.surface.chart.axes.array()),
        atol=1e-12,
    )
    varus = femoral_component_rotation(case, varus=a).contact.surface.chart.axes
    distal = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ [-1, 0, 0]
    assert distal[1] < 0
    np.testing.assert_allclose(
        np.asarray(varus.array()),
        np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        @ np.asarray(case.contact.surface.chart.axes.array()),
        atol=1e-12,
    )
    moved = femoral_component_translation(case, medialisation=0.002, distalisation=0.003, anteriorisation=0.004)
    np.testing.assert_allclose(point(moved) - point(case), [-3, -2, 4], atol=1e-9)


def some(kind: str) -> Treatment:
    return Treatment.of(kind, {name: 0.011 * (i + 1) for i, name in enumerate(KINDS[kind].amounts)})


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_agree_with_finite_differences(scene, kind):
    treatment = some(kind).prepared(scene)
    x0 = jnp.stack(treatment.values)

    def leaves(x):
        arrays = eqx.filter(treatment.with_values(x)(scene), eqx.is_array)
        found = jnp.concatenate([a.ravel() for a in jax.tree.leaves(arrays.effects)])
        return found, found

    slopes_and_leaves = jax.jit(jax.jacfwd(leaves, has_aux=True))
    slopes, _ = slopes_and_leaves(x0)
    h = 1e-5
    for i, column in enumerate(slopes.T):
        high, low = (slopes_and_leaves(x0 + s * h * jnp.eye(x0.size)[i])[1] for s in (1, -1))
        np.testing.assert_allclose(column, (high - low) / (2 * h), atol=1e-6, rtol=1e-6)
        assert jnp.abs(column).max() > 1e-3, "the amount changes nothing"


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_done_changes_nothing(scene, kind):
    idle = Treatment.of(kind, dict.fromkeys(KINDS[kind].amounts, 0.0))(scene)
    before, after = (eqx.filter(s, eqx.is_array) for s in (scene, idle))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-15), _sorted(before), _sorted(after))


def _sorted(scene):
    return {e.name: jax.tree.leaves(e) for e in scene.effects}


def test_treatments_follow_one_another_and_say_so(scene):
    first = Treatment.of("tibial_tuberosity_transfer", medialisation=0.010, distalisation=0.005)
    both = first.then(Treatment.of("femoral_component_rotation", external_rotation=np.radians(-3)))
    assert str(both) == ("tibial tuberosity 10 mm medially, 5 mm distally; femoral component turned 3 deg internally")
    assert both.names == (
        "tibial_tuberosity_transfer.medialisation",
        "tibial_tuberosity_transfer.distalisation",
        "femoral_component_rotation.external_rotation",
    )
    treated = both(scene)
    assert float(treated.effect("patellar_tendon").origin.y) == pytest.approx(0.0)
    twice = first.then(first)
    assert twice.names[2] == "tibial_tuberosity_transfer_2.medialisation"
    assert float(twice(scene).effect("patellar_tendon").origin.y) == pytest.approx(0.01 - 0.02)
    assert str(Treatment()) == "no treatment"
    assert str(first.with_values([0.0, 0.0])) == "tibial tuberosity as it is"
    assert "0 to 20 mm medially" in str(Treatment.of("tibial_tuberosity_transfer", medialisation=J([0.0, 0.02])))


def test_amounts_keep_their_order_when_traced(scene):
    treatment = Treatment.of("tibial_tuberosity_transfer", medialisation=0.0, anteriorisation=0.0, distalisation=0.0)
    origin = scene.effect("patellar_tendon").origin

    def moved(t):
        return t.with_values([0.003, 0.002, 0.001])(scene).effect("patellar_tendon").origin

    np.testing.assert_allclose(xyz(jax.jit(moved)(treatment)) - xyz(origin), [-1, -3, 2], atol=1e-12)


def test_amounts_are_mapped_over(scene):
    batch = Treatment.of("tibial_tuberosity_transfer", medialisation=jnp.linspace(0.0, 0.02, 5))
    y = jax.vmap(lambda t: t(scene).effect("patellar_tendon").origin.y)(batch)
    np.testing.assert_allclose(y, 0.01 - np.linspace(0, 0.02, 5))


def test_the_natural_knee_has_all_parts_that_treatments_expect():
    """As the refusals say of a scene without one of them."""
    knee = rig.knee()
    for kind in ("lateral_release", "mpfl_graft", "patellar_tendon_length_change", "femoral_derotation"):
        some(kind)(knee)


def test_what_a_scene_lacks_is_named(case):
    with pytest.raises(InputError, match=r"mpfl_graft of rig case 2.*no tendon or strands named 'mpfl'.*'quadriceps'"):
        Treatment.of("mpfl_graft", shortening=0.001)(case)
    with pytest.raises(InputError, match=r"'lpfl' or 'lateral_retinaculum'.*try: the natural knee.*--knee normal"):
        Treatment.of("lateral_release", release=1.0).prepared(case)
    with pytest.raises(InputError, match="try: name the part as the scene does"):
        tibial_tuberosity_transfer(case, 0.01, tendon="ligament")
    with pytest.raises(InputError, match=r"begins on the femur.*expected: on the tibia"):
        tibial_tuberosity_transfer(case, 0.01, tendon="quadriceps")
    bare = case.without("contact")
    for kind in ("button_position", "trochleoplasty", "femoral_component_rotation", "femoral_component_translation"):
        with pytest.raises(InputError, match=r"no contact between a button and a trochlea.*'gravity'"):
            some(kind)(bare)
    pull = PrescribedTension(
        jnp.ones((2, 1)),
        *(Vec3(*(jnp.zeros(s) for _ in range(3))) for s in ((2, 1), (1,))),
        0.0,
        1.0,
        "femur",
        name="quadriceps",
    )
    with pytest.raises(InputError, match="prescribed tension, which no length or stiffness changes"):
        Treatment.of("quadriceps_lengthening", lengthening=0.01)(case.without("quadriceps").with_effect(pull))


def test_a_groove_that_cannot_be_deepened_is_refused(case):
    with pytest.raises(InputError, match=r"degree 2.*expected: degree 4"):
        trochleoplasty(rig.case(2, "P2"), 0.001)
    flat = eqx.tree_at(lambda p: p.coefficients, case.contact.surface, jnp.zeros(21))
    with pytest.raises(InputError, match="no groove"):
        deepening_shape(flat)
    arrays, fixed = eqx.partition(case, eqx.is_array)
    with pytest.raises(InputError, match=r"traced surface.*deepening_shape"):
        jax.jit(lambda a: trochleoplasty(eqx.combine(a, fixed), 0.001).contact.surface.coefficients)(arrays)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Treatment.of("osteotomy", angle=1.0), "no treatment 'osteotomy'.*tibial_tuberosity_transfer"),
        (lambda: Treatment.of("trochleoplasty", depth=0.001), "no amount 'depth'.*expected: one of: deepening"),
        (lambda: Treatment.of("trochleoplasty", deepening=np.nan), "trochleoplasty.deepening: found nan"),
        (lambda: Treatment.of("trochleoplasty", deepening="much"), "found 'much'"),
        (lambda: Treatment.of("mpfl_graft", shortening=0.001, strands=3), "no amount 'strands'"),
    ],
)
def test_wrong_amounts_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
