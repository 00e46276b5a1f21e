"""Joints, functions and ligaments of models, against OpenSim itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from knee_models import FEMUR, axis, body, coordinate, function, ligaments, model
from opensim_process import ask, poses
from scipy.interpolate import CubicSpline

from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.interchange.osim_joints import spline
from pftwin.files.interchange.osim_model import read_model
from pftwin.files.interchange.osim_motion import poses as our_poses
from pftwin.model.effects.tendon import ToeSpring

KEPT = Path(__file__).with_name("opensim_4_6_poses.json")
X = "-0.3 0.1 0.5 0.9 1.6"
Y = "0.01 0.03 0.02 -0.01 0.005"


def plain(kind: str, name: str, parent: str, names: list[str]) -> str:
    """A joint without a description of its own, between frames that are turned and moved."""
    coordinates = "".join(coordinate(n, 0.0, -2, 2) for n in names)
    return (
        f'<{kind} name="{name}_joint"><socket_parent_frame>{name}_a</socket_parent_frame>'
        f"<socket_child_frame>{name}_b</socket_child_frame><coordinates>{coordinates}</coordinates><frames>"
        f'<PhysicalOffsetFrame name="{name}_a"><socket_parent>{parent}</socket_parent>'
        "<translation>0.1 -0.2 0.03</translation><orientation>0.3 -0.5 0.7</orientation></PhysicalOffsetFrame>"
        f'<PhysicalOffsetFrame name="{name}_b"><socket_parent>/bodyset/{name}</socket_parent>'
        "<translation>0.02 0.05 -0.04</translation><orientation>-0.2 0.4 0.1</orientation></PhysicalOffsetFrame>"
        f"</frames></{kind}>"
    )


KINDS = {"PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "GimbalJoint": 3, "FreeJoint": 6}


@pytest.fixture(scope="module")
def zoo(tmp_path_factory) -> Path:
    """The knee's model with a body at every kind of joint, one on a curved path, and one that follows another."""
    curved = (
        '<CustomJoint name="curved"><socket_parent_frame>/bodyset/femur_r</socket_parent_frame>'
        "<socket_child_frame>/bodyset/curved</socket_child_frame><coordinates>"
        + coordinate("roll", 0.0, -2, 2)
        + coordinate("follower", 0.0, -2, 2)
        + "</coordinates><SpatialTransform>"
        + axis("rotation1", "0.6 0 0.8", "roll", function("LinearFunction", 0.7, 0.1))
        + axis("rotation2", "0 1 0", "follower", function("LinearFunction", 1, 0))
        + axis("rotation3", "1 0 0", "roll", function("PiecewiseLinearFunction", X, Y))
        + axis("translation1", "1 0 0", "roll", function("SimmSpline", X, Y))
        + axis("translation2", "0 1 0", "", function("Constant", 0.25))
        + axis(
            "translation3",
            "0 0 1",
            "roll",
            '<MultiplierFunction name="function"><function>'
            "<PolynomialFunction><coefficients>0.3 -0.2 0.1</coefficients></PolynomialFunction></function>"
            "<scale>0.5</scale></MultiplierFunction>",
        )
        + "</SpatialTransform></CustomJoint>"
    )
    bodies = "".join(body(k.lower(), 1.0) for k in KINDS) + body("curved", 1.0)
    joints = curved + "".join(
        plain(k, k.lower(), FEMUR, [f"{k.lower()}_{i}" for i in range(n)]) for k, n in KINDS.items()
    )
    unnamed = function("SimmSpline", X, Y).replace(' name="function"', "")
    coupler = (
        '<ConstraintSet name="constraintset"><objects><CoordinateCouplerConstraint name="coupler">'
        f"<coupled_coordinates_function>{unnamed}"
        "</coupled_coordinates_function><independent_coordinate_names>roll</independent_coordinate_names>"
        "<dependent_coordinate_name>follower</dependent_coordinate_name></CoordinateCouplerConstraint></objects></ConstraintSet>"
    )
    text = model(forces=ligaments(), joints=joints, meshes=False)
    text = text.replace("</objects></BodySet>", bodies + "</objects></BodySet>").replace(
        "</Model>", coupler + "</Model>"
    )
    path = tmp_path_factory.mktemp("zoo") / "zoo.osim"
    path.write_text(text)
    return path


def coordinates_of(found) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    return {n: rng.uniform(-0.25, 1.2, 3) for n in found.tree.coordinates() if n != "follower"}


def same_poses(one: list[dict], other: list[dict], atol: float) -> None:
    for a, b in zip(one, other, strict=True):
        assert a.keys() == b.keys()
        for name in a:
            for part in (0, 1):
                np.testing.assert_allclose(a[name][part], b[name][part], atol=atol, err_msg=name)


def test_bodies_are_where_opensim_had_them(zoo):
    """Every kind of joint, at random coordinates; beside it what OpenSim 4.6 made of this model."""
    found = read_model(read_osim(zoo))
    ours = our_poses(found.tree, list(found.bodies), np.arange(3.0), coordinates_of(found))
    rows = [{n: (p.matrices()[k], p.positions[k]) for n, p in ours.items()} for k in range(3)]
    same_poses(rows, json.loads(KEPT.read_text()), atol=1e-7)


def test_opensim_still_has_them_there(zoo):
    found = read_model(read_osim(zoo))
    values = coordinates_of(found)
    rows = [{n: float(v[k]) for n, v in values.items()} for k in range(3)]
    same_poses(poses(zoo, rows, tuple(found.bodies)), json.loads(KEPT.read_text()), atol=1e-9)


SPLINE = """
import json, sys
import opensim as osim

x, y, at = (json.loads(a) for a in sys.argv[1:4])
made = osim.SimmSpline()
for a, b in zip(x, y):
    made.addPoint(a, b)
print(json.dumps([made.calcValue(osim.Vector(1, v)) for v in at]))
"""


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_simm_splines_are_opensims(count):
    x, y = (np.array([float(v) for v in text.split()])[:count] for text in (X, Y))
    at = np.linspace(x[0] - 0.2, x[-1] + 0.2, 23)
    theirs = ask(SPLINE, json.dumps(x.tolist()), json.dumps(y.tolist()), json.dumps(at.tolist()))
    np.testing.assert_allclose(spline(x, y)(at), theirs, atol=1e-12)


def test_a_spline_through_a_cubic_is_the_cubic():
    """What the end conditions are for; and its neighbour with other ends differs elsewhere."""
    x = np.array([0.0, 0.3, 0.7, 1.0, 1.4])
    at = np.linspace(0, 1.4, 31)
    np.testing.assert_allclose(spline(x, x**3 - x)(at), at**3 - at, atol=1e-12)
    y = np.sin(4 * x)
    assert np.abs(spline(x, y)(at) - CubicSpline(x, y, bc_type="natural")(at)).max() > 1e-3


TENSIONS = """
import json, sys
import opensim as osim

osim.Logger.setLevelString("Error")
model = osim.Model(sys.argv[1])
state = model.initSystem()
for name, value in json.loads(sys.argv[2]).items():
    model.getCoordinateSet().get(name).setValue(state, value, False)
model.realizeVelocity(state)
found = {}
for force in model.getForceSet():
    ligament = osim.Blankevoort1991Ligament.safeDownCast(force)
    if ligament is not None:
        found[force.getName()] = [ligament.getLength(state), ligament.getSpringForce(state)]
print(json.dumps(found))
"""


@pytest.mark.parametrize("flexion", [0.2, 0.8, 1.3])
def test_ligaments_pull_as_in_opensim(tmp_path, flexion):
    """By the imported stiffness, slack length and toe strain, through pftwin's own toe region."""
    path = tmp_path / "knee.osim"
    path.write_text(model(forces=ligaments(), meshes=False))
    theirs = ask(TENSIONS, path, json.dumps({"knee_flex_r": flexion}))
    pulled = 0
    for strand in read_model(read_osim(path)).ligaments:
        length, force = theirs[strand.name]
        strain = np.float64(length / strand.slack_length - 1)
        ours = strand.stiffness * float(ToeSpring(1.0, np.float64(strand.toe_strain)).at(strain).force)
        assert ours == pytest.approx(force, abs=1e-6)
        pulled += force > 0
    assert pulled
