"""Tension of a muscle at rest: against closed forms, and against OpenSim itself."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from opensim_process import ask

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_muscle_force import MILLARD, THELEN, read_force

# Moves the end of each muscle of a model along a line, and asks for its force in equilibrium.
TENSIONS = """
import json, sys
import opensim as osim

osim.Logger.setLevelString("Off")
model = osim.Model(sys.argv[1])
state = model.initSystem()
found = {}
for name, cases in json.loads(sys.argv[2]).items():
    muscle = model.getMuscles().get(name)
    found[name] = []
    for length, activation in cases:
        model.getCoordinateSet().get("slide").setValue(state, length)
        model.realizeVelocity(state)
        muscle.setActivation(state, activation)
        muscle.computeEquilibrium(state)
        model.realizeDynamics(state)
        found[name].append([muscle.getLength(state), muscle.getTendonForce(state)])
print(json.dumps(found))
"""


def tag(name: str, content: object) -> str:
    return f"<{name}>{content}</{name}>"


def tags(**values: object) -> str:
    return "".join(tag(name, value) for name, value in values.items())


NUMBERS = {
    "max_isometric_force": 848.8,
    "optimal_fiber_length": 0.083,
    "tendon_slack_length": 0.3,
    "pennation_angle_at_optimal": 0.243,
}
CURVES = (
    tag(
        "ActiveForceLengthCurve",
        tags(
            min_norm_active_fiber_length=0.5,
            transition_norm_fiber_length=0.8,
            max_norm_active_fiber_length=1.7,
            shallow_ascending_slope=0.5,
            minimum_value=0.03,
        ),
    )
    + tag(
        "FiberForceLengthCurve",
        tags(
            strain_at_zero_force=-0.2,
            strain_at_one_norm_force=0.5,
            stiffness_at_low_force=0.1,
            stiffness_at_one_norm_force=4,
            curviness=0.3,
        ),
    )
    + tag(
        "TendonForceLengthCurve",
        tags(
            strain_at_one_norm_force=0.033,
            stiffness_at_one_norm_force=50,
            norm_force_at_toe_end=0.5,
            curviness=0.8,
        ),
    )
)
SLACK = tag("FiberForceLengthCurve", tags(strain_at_one_norm_force=2))  # as in the model of Lenhart et al. 2015
THELENS = tags(FmaxTendonStrain=0.05, FmaxMuscleStrain=0.5, KshapeActive=0.4, KshapePassive=4.0)
KINDS = {
    "plain": (MILLARD, tags(**NUMBERS)),
    "straight": (MILLARD, tags(**{**NUMBERS, "pennation_angle_at_optimal": 0, "tendon_slack_length": 0.05})),
    "shaped": (MILLARD, tags(**{**NUMBERS, "minimum_activation": 0.0}) + CURVES),
    "slack": (MILLARD, tags(**NUMBERS) + SLACK),
    "rigid": (MILLARD, tags(ignore_tendon_compliance="true", **NUMBERS)),
    "undamped": (MILLARD, tags(fiber_damping=0.0, **NUMBERS)),
    "broad": (
        MILLARD,
        tags(maximum_pennation_angle=0.9, **{**NUMBERS, "pennation_angle_at_optimal": 0.7}),
    ),
    "thelen": (THELEN, tags(**NUMBERS)),
    "thelens": (THELEN, tags(**NUMBERS) + THELENS),
}


def element(kind: str, content: str = "", defaults: str = "") -> tuple[Element, dict[str, Element]]:
    """A muscle of one class and its model's defaults, as the reader of a file gives them."""

    def made(node: ElementTree.Element) -> Element:
        return Element(node.tag, node.get("name", ""), "m.osim", 7, node.text or "", [made(c) for c in node])

    own, other = (made(ElementTree.fromstring(f'<{kind} name="m">{c}</{kind}>')) for c in (content, defaults))
    return own, {kind: other} if defaults else {}


def force(kind: str, content: str = "", defaults: str = ""):
    return read_force(*element(kind, content, defaults))


def osim(folder) -> str:
    """A model of a body that slides along x, with all muscles from the ground to it."""
    muscles = ""
    for name, (kind, content) in KINDS.items():
        points = "".join(
            f'<PathPoint name="{name}{k}"><socket_parent_frame>{frame}</socket_parent_frame>'
            "<location>0 0 0</location></PathPoint>"
            for k, frame in enumerate(("/ground", "/bodyset/block"))
        )
        path = (
            f'<GeometryPath name="geometrypath"><PathPointSet><objects>{points}</objects></PathPointSet></GeometryPath>'
        )
        muscles += f'<{kind} name="{name}">{path}{content}</{kind}>'
    (folder / "sliding.osim").write_text(
        '<?xml version="1.0" encoding="UTF-8"?><OpenSimDocument Version="40000"><Model name="sliding">'
        '<BodySet name="bodyset"><objects><Body name="block"><mass>1</mass><mass_center>0 0 0</mass_center>'
        "<inertia>1 1 1 0 0 0</inertia></Body></objects></BodySet>"
        '<JointSet name="jointset"><objects><SliderJoint name="slider"><socket_parent_frame>/ground'
        "</socket_parent_frame><socket_child_frame>/bodyset/block</socket_child_frame><coordinates>"
        '<Coordinate name="slide"><range>-5 5</range></Coordinate></coordinates></SliderJoint></objects></JointSet>'
        f'<ForceSet name="forceset"><objects>{muscles}</objects></ForceSet></Model></OpenSimDocument>'
    )
    return str(folder / "sliding.osim")


def test_tensions_are_opensims(tmp_path):
    """From lengths at which the tendon is slack to fibres of 1.7 times their optimal length."""
    ours = {name: force(*kind) for name, kind in KINDS.items()}
    cases = {
        name: [
            (m.slack + share * m.fiber * np.cos(m.pennation), a)
            for share in np.linspace(0.15, 1.7, 32)
            for a in (0.0, 0.02, 0.3, 1.0)
        ]
        for name, m in ours.items()
    }
    theirs = ask(TENSIONS, osim(tmp_path), json.dumps(cases))
    for name, m in ours.items():
        lengths, activations = np.array(cases[name]).T
        measured, expected = np.array(theirs[name]).T
        np.testing.assert_allclose(measured, lengths, atol=1e-12)
        np.testing.assert_allclose(m.tensions(lengths, activations), expected, atol=1e-3, err_msg=name)
        assert expected.max() > 600
        assert expected.min() < 2


KEPT = {  # OpenSim 4.6's tensions [N] at shares of the optimal fibre length along the tendon beyond its slack length
    ("plain", 0.8, 0.3): 198.95866,
    ("plain", 1.3, 0.02): 79.87119,
    ("shaped", 1.1, 1.0): 882.11270,
    ("slack", 1.5, 0.3): 194.08161,
    ("rigid", 0.9, 0.5): 393.58496,
    ("undamped", 0.6, 1.0): 238.93925,
    ("thelen", 1.2, 1.0): 824.49726,
    ("thelens", 0.7, 0.1): 59.76622,
}


@pytest.mark.parametrize("case", KEPT)
def test_tensions_are_as_opensim_4_6_had_them(case):
    name, share, activation = case
    m = force(*KINDS[name])
    length = m.slack + share * m.fiber * np.cos(m.pennation)
    assert m.tensions(np.array([length]), np.array([activation])) == pytest.approx(KEPT[case], abs=1e-3)


def test_a_straight_muscle_at_its_optimal_length_pulls_with_its_strength_times_the_activation():
    """With a tendon that does not stretch nothing else is in it: no passive force, no pennation."""
    m = force(MILLARD, tags(**{**NUMBERS, "pennation_angle_at_optimal": 0}, ignore_tendon_compliance="true"))
    for a in (0.1, 0.5, 1.0):
        assert m.tensions(np.array([0.3 + 0.083]), np.array([a])) == pytest.approx(848.8 * a, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "stretched", "fiber"),
    [
        ("plain", 1.049, 1.7),
        ("shaped", 1.033, 1.5),
        ("slack", 1.049, 3.0),
        ("thelen", 1.04, 1.6),
        ("thelens", 1.05, 1.5),
    ],
)
def test_curves_are_one_where_their_strains_say(name, stretched, fiber):
    """The strain at one normalised force, of tendon and of passive fibre; the active one at its optimal length."""
    curves = force(*KINDS[name]).curves
    assert curves.tendon(np.array(stretched)) == pytest.approx(1, abs=1e-9)
    assert curves.passive(np.array(fiber)) == pytest.approx(1, abs=1e-9)
    assert curves.active(np.array(1.0)) == pytest.approx(1, abs=1e-9)
    assert curves.tendon(np.array([0.2, 1.0])) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_a_muscle_that_is_too_short_is_slack_and_one_of_an_absurd_length_has_a_number(name):
    m = force(*KINDS[name])
    assert (m.tensions(np.array([0.01, m.slack, m.slack + 1e-9]), np.ones(3)) == 0).all()
    assert np.isfinite(m.tensions(np.array([5.0, 100.0]), np.ones(2))).all()


def test_what_a_muscle_does_not_say_is_as_in_the_models_defaults():
    own = force(MILLARD, tags(max_isometric_force=500.0), tags(max_isometric_force=700.0, optimal_fiber_length=0.05))
    assert (own.strength, own.fiber, own.slack, own.least_activation) == (500.0, 0.05, 0.2, 0.01)
    softer = force(MILLARD, "", tag("TendonForceLengthCurve", tags(strain_at_one_norm_force=0.1)))
    assert softer.curves.tendon(np.array(1.1)) == pytest.approx(1, abs=1e-9)


WRONG = {
    "no strength": (MILLARD, tags(max_isometric_force=0), "a positive force"),
    "no fibre": (THELEN, tags(optimal_fiber_length=-0.1), "positive lengths"),
    "no tendon": (MILLARD, tags(tendon_slack_length=0), "positive lengths"),
    "across": (MILLARD, tags(pennation_angle_at_optimal=1.6), "a pennation"),
    "no number": (MILLARD, tags(optimal_fiber_length="long"), "1 finite number"),
    "no least": (MILLARD, tags(minimum_activation=1.0), "a minimum activation"),
    "half a shape": (MILLARD, tag("TendonForceLengthCurve", tags(curviness=0.5)), "all of .*, or none"),
    "a soft tendon": (MILLARD, tag("TendonForceLengthCurve", tags(strain_at_one_norm_force=-0.1)), "a positive strain"),
    "no shoulder": (
        MILLARD,
        tag("ActiveForceLengthCurve", tags(transition_norm_fiber_length=0.2)),
        "ascending lengths",
    ),
    "a steep plateau": (MILLARD, tag("ActiveForceLengthCurve", tags(shallow_ascending_slope=9)), "a plateau"),
    "backwards": (
        MILLARD,
        tag("FiberForceLengthCurve", tags(strain_at_zero_force=0.5, strain_at_one_norm_force=0.5)),
        "a strain at one",
    ),
    "a stiff foot": (
        MILLARD,
        tag("FiberForceLengthCurve", tags(stiffness_at_low_force=9, stiffness_at_one_norm_force=3, curviness=1)),
        "stiffnesses below and above",
    ),
    "no shape": (THELEN, tags(KshapeActive=0), "positive strains"),
    "a rigid tendon": (THELEN, tags(ignore_tendon_compliance="true"), "a tendon that stretches"),
    "another class": ("RigidTendonMuscle", "", "one of: Millard2012EquilibriumMuscle, Thelen2003Muscle"),
}


@pytest.mark.parametrize("case", WRONG)
def test_numbers_that_no_muscle_has_are_refused_by_name_and_line(case):
    kind, content, expected = WRONG[case]
    with pytest.raises(InputError, match=f"m.osim, line 7: .*{expected}") as caught:
        force(kind, content)
    assert kind in str(caught.value) or "long" in str(caught.value)
