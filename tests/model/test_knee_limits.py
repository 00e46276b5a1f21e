"""What a knee can be: each limit refuses what lies beyond it, can be set by name, and lets real knees through."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_result, small_scene, vec

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array, number, vector
from pftwin.base.quantities import quantity
from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.base import Instant, Load
from pftwin.model.effects.line_elements import ElasticLine
from pftwin.model.effects.tendon import StrandGroup, ToeTendon
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.limits import Limits, upward_lines
from pftwin.model.motion import KneeMotion
from pftwin.model.number_place import start_length
from pftwin.model.scene import check


def knee(name: str | None = None, value: float = 0.0, **limits: float):
    scene = small_scene(11).with_limits(**limits)
    return scene if name is None else scene.set(name, value)


def moving(flexion=0.8, adduction=0.05, rotation=-0.03, turned_at=None):
    """The small knee with a tibia at given angles [rad], in one frame turned by 180 deg."""
    times = 0.01 * np.arange(11)
    angles = (np.broadcast_to(a, 11) for a in (flexion, adduction, rotation))
    q = tibiofemoral_orientation(*(np.array(a) for a in angles))
    rows = np.stack([q.w, q.x, q.y, q.z], axis=1)
    if turned_at is not None:
        w, x, y, z = rows[turned_at]
        rows[turned_at] = [-x, w, z, -y]  # by 180 deg about its long axis
    tibia = PoseSeries(times, np.zeros((11, 3)), rows)
    return eqx.tree_at(lambda s: s.motion, knee(), KneeMotion.from_poses(None, tibia))


def weighing(inertia: float):
    return eqx.tree_at(lambda s: s.patella.inertia, knee(), vec(inertia, inertia, inertia))


BEYOND = {  # scene, the limit, what the message says: figures by hand
    "a patella of 120 kg": (lambda: knee("patella.mass", 120.0), "most_mass_kg", "mass is 120 kg"),
    "of 0.1 g": (lambda: knee("patella.mass", 1e-4), "least_mass_kg", "mass is 0.0001 kg"),
    # sqrt(30 kg m^2 / 0.12 kg) = 15.81 m
    "an inertia of 30 kg m^2": (lambda: weighing(30.0), "most_gyration_mm", "1.581e+04 mm"),
    "an inertia of 1e-9 kg m^2": (lambda: weighing(1e-9), "least_gyration_mm", "0.09129 mm"),
    "a button of 22 m": (lambda: knee("contact.radius", 22.0), "most_button_radius_mm", "2.2e+04 mm"),
    "a button of 22 um": (lambda: knee("contact.radius", 22e-6), "least_button_radius_mm", "0.022 mm"),
    "a slack length of 143 m": (lambda: knee("quadriceps.slack_length", 143.2), "most_slack_share", "quadriceps"),
    "a slack length of 0.14 mm": (lambda: knee("quadriceps.slack_length", 1.4e-4), "least_slack_share", "quadriceps"),
    "a tendon of N/um": (lambda: knee("quadriceps.stiffness", 156e6), "most_force_N", "pull of quadriceps"),
    "an origin in millimetres": (lambda: knee("quadriceps.origin.x", 220.0), "most_line_mm", "2.2e+05 mm"),
    "gravity in mm/s^2": (lambda: knee("gravity.acceleration.z", -9810.0), "most_acceleration_m_per_s2", "9810 m/s^2"),
    "a knee that bends forward": (lambda: moving(flexion=-1.0), "least_flexion_deg", "-57.3 deg"),
    "by more than half a turn": (lambda: moving(flexion=3.1), "most_flexion_deg", "177.6 deg"),
    "sideways": (lambda: moving(adduction=1.0), "most_adduction_deg", "57.3 deg"),
    "about its long axis": (lambda: moving(rotation=2.0), "most_rotation_deg", "114.6 deg"),
    # pi in 10 ms
    "a frame turned by 180 deg": (lambda: moving(turned_at=5), "most_angular_speed_rad_per_s", "314.2 rad/s"),
}


FOLLOWING = {  # what else is then beyond its limit
    "a patella of 120 kg": {"least_gyration_mm": 0.1},
    "of 0.1 g": {"most_gyration_mm": 1000.0},
    "an origin in millimetres": {"least_slack_share": 0.0, "most_force_N": 1e6},
    "a frame turned by 180 deg": {"most_rotation_deg": 180.0},
}


@pytest.mark.parametrize("case", BEYOND)
def test_what_no_knee_is_is_refused_with_its_limit_by_name_and_let_through_where_that_is_set(case):
    make, limit, words = BEYOND[case]
    scene = make()
    with pytest.raises(InputError, match=limit) as caught:
        check(scene)
    assert words in str(caught.value)
    assert f"pftwin --allow {limit}=" in str(caught.value)
    enough = float(str(caught.value).split(f"--allow {limit}=")[1].split(",")[0])
    allowed = {limit: enough, **FOLLOWING.get(case, {})}
    check(scene.with_limits(**allowed))
    check(dataclasses.replace(scene, limits=None))  # any body on any surface


def test_nothing_that_pulls_is_refused():
    scene = knee().without("quadriceps").without("patellar_tendon")
    with pytest.raises(InputError, match=r"lines of force .* is 0; expected: at least 1, .*least_lines"):
        check(scene)
    check(scene.with_limits(least_lines=0))


def pulling(tension: float, origin: tuple[float, float, float], body: str = "femur"):
    """The small knee with lines of a prescribed tension from above the button, in place of the quadriceps."""
    line = PrescribedTension(
        number([[0.0, 0.0], [0.0, tension]]),
        vector(np.broadcast_to(origin, (2, 2, 3))),
        vector([[0.02, 0.0, -0.008]] * 2),
        start_time=0.0,
        interval=0.05,
        body=body,
        name="muscle",
    )
    return knee().without("quadriceps").with_effect(line)


def test_what_pulls_upward_is_counted():
    """Lines that can pull, and within 60 deg of proximal; none from the tibia does."""
    assert upward_lines(knee()) == 1
    assert upward_lines(knee().without("quadriceps")) == 0
    above = np.array([-0.005 + 0.02, 0.001, 0.05 - 0.008])  # the insertion; the patella is not turned at the start
    side = np.tan(np.radians(59.0)), np.tan(np.radians(61.0))
    for k, expected in zip(side, (1, 0), strict=True):
        place = tuple(above + 0.05 * np.array([1, k, 0]))
        assert upward_lines(pulling(3.0, place)) == expected
        assert upward_lines(pulling(0.0, place)) == 0
    assert upward_lines(pulling(3.0, (0.5, 0.0, 0.0), "tibia")) == 0


def test_a_motion_that_nothing_pulls_upward_is_invalid():
    result = small_result()
    limits = {"most_start_turn_deg": 20}
    scene = result.scene.without("quadriceps")
    assert dataclasses.replace(result, scene=scene).verdict.valid  # no limits: any body on any surface
    as_knee = dataclasses.replace(result, scene=scene.with_limits(**limits))
    assert as_knee.verdict.reasons == (
        "lines of force that pull the patella upward: 0 (at least 1: least_upward_lines)",
    )
    assert as_knee.summary().startswith("INVALID: lines of force that pull the patella upward: 0")
    allowed = scene.with_limits(least_upward_lines=0, **limits)
    assert dataclasses.replace(result, scene=allowed).verdict.valid


def test_a_parameter_of_a_quadriceps_that_is_missing_says_that_nothing_pulls_upward():
    scene = small_result().scene.without("quadriceps")
    assert scene.with_limits(most_start_turn_deg=20).get("K1") == scene.get("K1")
    lacking = r"no parameter 'K2': .* lines of force that pull the patella upward: 0 .*; try: .*quadriceps"
    with pytest.raises(InputError, match=lacking):
        scene.with_limits(most_start_turn_deg=20).get("K2")
    with pytest.raises(InputError, match=r"has 1 tendon\(s\); expected: K1, L1; try: name these only") as found:
        scene.get("K2")  # no limits: any body on any surface
    assert "upward" not in str(found.value)


def test_moments_that_no_body_has_are_refused_whatever_the_limits():
    scene = knee()
    flat = eqx.tree_at(lambda s: s.patella.inertia.z, scene, jnp.asarray(6e-5))  # 3e-5 + 3e-5: a thin plate
    check(flat)
    with pytest.raises(InputError, match="larger than the sum of the other two"):
        check(eqx.tree_at(lambda s: s.patella.inertia.z, scene, jnp.asarray(7e-5)))


def test_real_knees_are_let_through():
    for n in (1, 2, 3, 4):
        check(rig.case(n).with_limits())
    check(small_scene().with_limits())


@pytest.mark.parametrize(("limits", "words"), [({"most_weight": 1.0}, "no limit"), ({"most_mass_kg": "5"}, "'5'")])
def test_a_limit_that_is_none_is_refused(limits, words):
    with pytest.raises(InputError, match=words):
        Limits.of(limits)


def test_an_equilibrium_far_from_the_recorded_start_makes_the_motion_invalid():
    """The small knee's equilibrium is 8.6 mm and 17.1 deg from where its search begins."""
    result = small_result()
    assert result.verdict.valid  # no limits: the start is a guess
    as_knee = dataclasses.replace(result, scene=result.scene.with_limits())
    assert as_knee.verdict.reasons == (
        "the equilibrium is 17.1 deg from the recorded start (at most 15: most_start_turn_deg)",
    )
    assert as_knee.summary().startswith("INVALID: the equilibrium is 17.1 deg")
    nearer = result.scene.with_limits(most_start_shift_mm=5.0)
    assert [r[:24] for r in dataclasses.replace(result, scene=nearer).verdict.reasons] == [
        "the equilibrium is 8.6 m",
        "the equilibrium is 17.1 ",
    ]
    assert dataclasses.replace(result, scene=result.scene.with_limits(most_start_turn_deg=20)).verdict.valid
    treated = dataclasses.replace(result.scene, limits=Limits().of_treated())
    assert dataclasses.replace(result, scene=treated).verdict.valid


def test_the_pull_of_strands_is_by_strain():
    """2 kN per unit strain, 60 mm slack, stretched to twice that and more: over 2 kN, and not 2 kN times metres."""
    scene = knee(most_force_N=1500.0, least_slack_share=0.0)
    line = scene.effect("quadriceps")
    two = np.ones(2)
    ends = (vector(np.tile(host_array(p), (2, 1))) for p in (line.insertion, line.origin))
    strands = StrandGroup(*(number(v * two) for v in (2e3, 0.06, 0.01, 0.0)), *ends, "femur", name="quadriceps")
    length = float(start_length(scene, line))
    assert length > 0.12
    pull = 2e3 * (length / 0.06 - 1 - 0.5 * 0.01)  # Blankevoort and Huiskes 1991: k (e - e1), with 2 e1 = 0.01
    with pytest.raises(InputError, match=rf"pull of quadriceps at the start is {pull:.4g} N"):
        check(scene.with_effect(strands))


class Hardening(ElasticLine):
    """A line from elsewhere that hardens: F = K s (1 + s / L0), never below 0; it says no more than its load."""

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True))
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True))
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Its pull."""
        line = self.line(now)
        stretch = jnp.maximum(line.length - self.slack_length, 0.0)
        tension = self.stiffness * stretch * (1 + stretch / self.slack_length)
        slope = self.stiffness * (1 + 2 * stretch / self.slack_length)
        return Load(stiff=(line.term(tension, tension, slope, jnp.zeros_like(slope)),)), memory


def pulled_by(kind: type[ElasticLine], *more: float):
    """The small knee with a quadriceps of this kind with a slack length of 140 mm; and its stretch [m]."""
    scene = knee(least_slack_share=0.0)
    old: Any = scene.effect("quadriceps")
    line: Any = kind(
        number(500.0), number(0.14), *map(number, more), old.insertion, old.origin, "femur", name="quadriceps"
    )
    return scene.with_effect(line), float(start_length(scene, line)) - 0.14


@pytest.mark.parametrize("kind", ["toe", "hardening"])
def test_the_pull_of_a_line_is_that_of_its_own_law(kind):
    """A toe region pulls less, and a hardening line more, than its stiffness times its stretch."""
    if kind == "toe":
        scene, s = pulled_by(ToeTendon, 1.0, 0.0)
        pull = 500.0 * s**2 / (2 * 0.14)
        assert pull < 0.5 * 500.0 * s
    else:
        scene, s = pulled_by(Hardening)
        pull = 500.0 * s * (1 + s / 0.14)
        assert pull > 1.3 * 500.0 * s
    check(scene.with_limits(least_slack_share=0.0, most_force_N=1.001 * pull))
    with pytest.raises(InputError, match=rf"pull of quadriceps at the start is {pull:.4g} N"):
        check(scene.with_limits(least_slack_share=0.0, most_force_N=0.999 * pull))


def test_the_pull_of_a_slack_line_is_none():
    scene, _ = pulled_by(ToeTendon, 1.0, 0.0)
    check(scene.set("L1", 0.25).with_limits(most_slack_share=2.0, most_force_N=1e-9).without("patellar_tendon"))
