"""A flat button, tilted and off the middle, on a moving plate with layers: all its sums written out in numpy."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import plate
from pressed_button import disc
from scenes import J, vec
from scipy.spatial.transform import Rotation as Turn

from pftwin.base.spatial import Quaternion, Twist, Vec3
from pftwin.dynamics.ledger import Powers
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.model.effects.base import Instant, Patella
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.model.motion import Frame

SOFT, HARD = (5e6, 0.3, 2e-3), (40e6, 0.45, 3e-3)  # modulus [Pa], Poisson ratio, thickness [m]
DAMPING, STEP = 1.5e-3, 2e-3  # [s]
ORIGIN = np.array([0.004, -0.003, -0.007])  # of the button's mesh from the centre of mass, patella axes
BUTTON, PLATE = disc(0.0), plate(8, 0.02)

FEMUR_AT, FEMUR_TURN = np.array([0.1, -0.2, 0.05]), Turn.from_rotvec([0.4, -0.9, 0.3])
FEMUR_V, FEMUR_W = np.array([0.3, -0.1, 0.2]), np.array([2.0, -3.0, 1.5])  # world
IN_FEMUR, TILT = np.array([0.002, 0.0035, -1e-4]), Turn.from_rotvec([0.03, -0.05, 0.6])  # of the button's mesh
V, SPIN = np.array([0.25, -0.12, 0.17]), np.array([1.0, 2.5, -4.0])  # of the patella: world, and its own axes


@pytest.fixture(scope="module")
def effect() -> ElasticFoundation:
    side = PLATE.vertices[PLATE.faces].mean(axis=1)[:, 1] > 0
    law = LinearFoundation(checked_layer(*SOFT), checked_layer(*HARD))
    femur = pressed_surface(PLATE, labels=side.astype(int))
    return ElasticFoundation(femur, pressing_surface(BUTTON), law, vec(*ORIGIN), J(DAMPING), name="layers")


def compliance() -> float:
    """Both layers give way: the sum of h (1 + nu) (1 - 2 nu) / (E (1 - nu))."""
    return sum(h * (1 + nu) * (1 - 2 * nu) / (e * (1 - nu)) for e, nu, h in (SOFT, HARD))


class Written:
    """Every triangle's contact."""

    def __init__(self) -> None:
        corners = BUTTON.vertices[BUTTON.faces]
        middles = corners.mean(axis=1)
        vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.area = np.abs(TILT.apply(vectors)[:, 2])  # across the plate's normal
        self.points = IN_FEMUR + TILT.apply(middles)  # femur frame
        self.depth = -self.points[:, 2]
        self.turn = FEMUR_TURN * TILT
        self.position = FEMUR_AT + FEMUR_TURN.apply(IN_FEMUR) - self.turn.apply(ORIGIN)  # of the centre of mass
        world = FEMUR_AT + FEMUR_TURN.apply(self.points)
        self.normal = FEMUR_TURN.apply([0.0, 0.0, 1.0])
        own = self.turn.inv().apply(self.normal)
        arms = ORIGIN + middles
        self.rows = np.hstack([np.tile(self.normal, (len(arms), 1)), np.cross(arms, own)])
        velocity = V + np.cross(self.turn.apply(SPIN), world - self.position)
        self.femur = FEMUR_V + np.cross(FEMUR_W, world - FEMUR_AT)  # of its points there
        self.rate = -(velocity - self.femur) @ self.normal
        self.stiffness = self.area / compliance()
        touching = self.depth > 0
        self.elastic = np.where(touching, self.stiffness * self.depth, 0.0)
        force = self.elastic + DAMPING * self.stiffness * self.rate
        self.pushes = touching & (force > 0)
        self.force = np.where(self.pushes, force, 0.0)
        # Minus the change of the projected areas with the patella's turning, for what is stored on each.
        turning = (
            np.cross(own, vectors) * np.sign(vectors @ own)[:, None] * (0.5 * self.depth**2 / compliance())[:, None]
        )
        self.turning = np.array([0, 0, 0, *turning[self.pushes].sum(axis=0)])
        self.femur_turns = self.turning[3:] @ self.turn.inv().apply(FEMUR_W)  # its power


@pytest.fixture(scope="module")
def by_hand() -> Written:
    return Written()


def rotated(turn: Turn) -> Quaternion:
    return Quaternion.from_array(J(turn.as_quat(scalar_first=True)))


def instant(by_hand: Written, ahead: float = 0.0) -> Instant:
    """All that moves, a little later or earlier."""
    patella_w = by_hand.turn.apply(SPIN)
    turn, femur = (Turn.from_rotvec(ahead * w) * t for w, t in ((patella_w, by_hand.turn), (FEMUR_W, FEMUR_TURN)))
    frame = Frame(vec(*(FEMUR_AT + ahead * FEMUR_V)), rotated(femur).rotation(), vec(*FEMUR_V), vec(*FEMUR_W))
    patella = Patella(vec(*(by_hand.position + ahead * V)), rotated(turn).rotation(), vec(*V), vec(*SPIN))
    return Instant(patella, frame, frame, J(0.0), J(0.0))


@eqx.filter_jit
def seen(effect, now):
    return effect.load(now, None)[0], effect.report(now, None)[0]


@pytest.fixture(scope="module")
def found(effect, by_hand):
    return seen(effect, instant(by_hand))


def test_part_of_it_is_in_contact(by_hand):
    assert 50 < by_hand.pushes.sum() < 350
    assert len(set(by_hand.points[by_hand.pushes, 1] > 0)) == 2  # on both facets


def test_forces_moments_and_slopes_are_those_of_all_triangles(found, by_hand):
    bed, on = found[0].bed, by_hand.pushes
    rows = by_hand.rows[on]
    expected = by_hand.force[on] @ rows + by_hand.turning
    np.testing.assert_allclose(bed.force, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(bed.elastic, by_hand.elastic[on] @ rows + by_hand.turning, rtol=1e-9, atol=1e-12)
    own = (rows.T * by_hand.stiffness[on]) @ rows
    np.testing.assert_allclose(bed.stiffness, own, rtol=1e-8, atol=1e-9 * np.abs(own).max(axis=1, keepdims=True).min())
    np.testing.assert_allclose(bed.slope(J(STEP)), (STEP + DAMPING) * own, rtol=1e-8, atol=1e-12 * own.max())
    assert float(bed.size) == pytest.approx(by_hand.force.sum(), rel=1e-12)
    whole = found[0].total()
    np.testing.assert_allclose([*whole.force.array(), *whole.moment.array()], expected, rtol=1e-9, atol=1e-12)
    assert np.abs(expected[3:]).min() > 1e-4  # newton metres, about every axis


def test_pressures_are_those_of_all_triangles(found, by_hand):
    report, touching = found[1], by_hand.depth > 0
    pressure = np.where(touching, by_hand.depth, 0.0) / compliance()
    area, borne = by_hand.area[touching].sum(), by_hand.area * pressure
    assert float(report["area"]) == pytest.approx(area, rel=1e-12)
    assert float(report["max_pressure"]) == pytest.approx(pressure.max(), rel=1e-9)
    assert float(report["mean_pressure"]) == pytest.approx(borne.sum() / area, rel=1e-9)
    assert float(report["indentation"]) == pytest.approx(by_hand.depth.max(), rel=1e-9)
    np.testing.assert_allclose(report["center_of_pressure"][:2], borne @ by_hand.points[:, :2] / borne.sum(), rtol=1e-9)
    assert [float(report[f"force_{x}"]) for x in "xyz"] == pytest.approx([0, 0, by_hand.force.sum()], abs=1e-9)
    # As if each triangle were a square of its area that meets the border, at y = 0, along its sides.
    lateral = np.clip(0.5 + by_hand.points[:, 1] / np.sqrt(BUTTON.face_areas), 0, 1)
    assert np.sum((lateral[touching] > 0) & (lateral[touching] < 1)) > 10
    for facet, share in (("medial", 1 - lateral), ("lateral", lateral)):
        assert float(report[f"force_{facet}"]) == pytest.approx(share @ by_hand.force, rel=1e-9)
        place = (share * borne) @ by_hand.points / (share @ borne)
        np.testing.assert_allclose(report[f"point_{facet}"], place, rtol=1e-9)


def test_what_is_lost_is_what_damping_takes(found, by_hand):
    heat = ((by_hand.force - by_hand.elastic) * by_hand.rate)[by_hand.pushes].sum()
    assert float(found[0].dissipation()) == pytest.approx(heat, rel=1e-9)


def test_what_is_stored_changes_by_the_relative_motion_alone(effect, by_hand):
    """The energy's slope in time, both bodies moving: minus the elastic forces' power on the patella in the femur."""
    undamped = eqx.tree_at(lambda e: e.damping_time, effect, J(0.0))
    load, h = seen(undamped, instant(by_hand))[0], 1e-7
    ends = [float(seen(undamped, instant(by_hand, s * h))[0].energy) for s in (1, -1)]
    stored = 0.5 * (by_hand.stiffness * by_hand.depth**2)[by_hand.depth > 0].sum()
    assert float(load.energy) == pytest.approx(stored, rel=1e-9)
    power = (ends[0] - ends[1]) / (2 * h)
    turned = by_hand.turning[3:] @ (SPIN - by_hand.turn.inv().apply(FEMUR_W))
    assert power == pytest.approx((by_hand.elastic * by_hand.rate).sum() - turned, rel=1e-6)
    bed = load.bed
    twist = jnp.concatenate([bed.velocity.array(), bed.spin.array()])
    assert power == pytest.approx(-float(bed.elastic @ twist), rel=1e-6)


def test_a_moving_femur_puts_in_its_own_power(found, by_hand):
    """Work is force times the velocity of the femur's points; heat is what springs do not take of it."""
    moving = Twist(vec(*V), vec(*SPIN))
    powers = Powers.of([found[0]], moving, moving)
    on = by_hand.pushes
    force, elastic, rate = by_hand.force[on], by_hand.elastic[on], by_hand.rate[on]
    work = (force * (by_hand.femur[on] @ by_hand.normal)).sum() + by_hand.femur_turns
    assert float(powers.work) == pytest.approx(work, rel=1e-9)
    assert float(powers.heat) == pytest.approx(((force - elastic) * rate).sum(), rel=1e-9)
    given = powers.lossy + powers.potential.power(moving)
    assert float(given) == pytest.approx(float(found[0].total().power(moving)), rel=1e-9)  # all that acts on it


FASTER = np.array([0.3, 0.1, 0, 0, 2, 0])


def test_a_patella_faster_than_its_trial_twist(found, by_hand):
    """The femur's own motion is told by the look, whatever the patella does; the rate is that of the velocity."""
    looked, faster = Twist(vec(*V), vec(*SPIN)), Twist(vec(*(V + FASTER[:3])), vec(*(SPIN + FASTER[3:])))
    powers = Powers.of([found[0]], looked, faster)
    on = by_hand.pushes
    force, elastic = by_hand.force[on], by_hand.elastic[on]
    rate = by_hand.rate[on] - by_hand.rows[on] @ FASTER
    work = (force * (by_hand.femur[on] @ by_hand.normal)).sum() + by_hand.femur_turns
    assert float(powers.work) == pytest.approx(work, rel=1e-9)
    assert float(powers.heat) == pytest.approx(((force - elastic) * rate).sum(), rel=1e-9)


def test_counted_from_the_centre_of_mass_an_arm_loses_it(effect):
    moved = effect.recentred(vec(0.001, 0.002, -0.003))
    np.testing.assert_allclose(Vec3.array(moved.origin), ORIGIN - [0.001, 0.002, -0.003], rtol=1e-12)
