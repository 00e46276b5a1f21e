"""Paths that wrap: imported as obstacles, and lengths and directions beside those of OpenSim itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from knee_models import FEMUR, PATELLA, PT, TIBIA, as_left, ligament, model, write_knee
from opensim_process import ask
from scipy.spatial.transform import Rotation

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.files.interchange import import_osim
from pftwin.files.scene_file import load_scene
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.geometry.wrapping.sphere import Sphere

SCRIPT = """
import json, sys
import numpy as np
import opensim as osim

osim.Logger.setLevelString("Error")
of = json.loads(sys.argv[1])
model = osim.Model()
body = osim.Body("bone", 1.0, osim.Vec3(0), osim.Inertia(1.0))
model.addBody(body)
model.addJoint(osim.WeldJoint("weld", model.getGround(), body))
if of["kind"] == "cylinder":
    wrap = osim.WrapCylinder()
    wrap.set_radius(of["size"])
    wrap.set_length(of["length"])
elif of["kind"] == "sphere":
    wrap = osim.WrapSphere()
    wrap.set_radius(of["size"])
else:
    wrap = osim.WrapEllipsoid()
    wrap.set_dimensions(osim.Vec3(*of["size"]))
wrap.setName("wrap")
wrap.set_quadrant(of["quadrant"])
wrap.set_translation(osim.Vec3(*of["translation"]))
wrap.set_xyz_body_rotation(osim.Vec3(*of["rotation"]))
body.addWrapObject(wrap)
force = osim.PathSpring("line", 0.01, 1.0, 0.0)
path = force.updGeometryPath()
path.appendNewPathPoint("start", body, osim.Vec3(0.3, 0.0, 0.0))
path.appendNewPathPoint("end", body, osim.Vec3(0.4, 0.0, 0.0))
path.addPathWrap(wrap)
model.addForce(force)
found = []
for pair in of["pairs"]:
    for k, place in enumerate(pair):
        osim.PathPoint.safeDownCast(path.getPathPointSet().get(k)).setLocation(osim.Vec3(*place))
    state = model.initSystem()
    model.realizePosition(state)
    points = osim.ArrayPointForceDirection()
    path.getPointForceDirections(state, points)
    p = np.array([[points.get(i).point()[k] for k in range(3)] for i in range(points.getSize())])
    ways = [a / np.linalg.norm(a) for a in (p[1] - p[0], p[-2] - p[-1])]
    found.append([path.getLength(state), len(p), *ways[0], *ways[1]])
print(json.dumps(found))
"""


def in_opensim(kind, size, pairs, *, translation=(0, 0, 0), rotation=(0, 0, 0), quadrant="all") -> np.ndarray:
    """Length, number of points and both directions of each line."""
    of = {"kind": kind, "size": size, "length": 1.0, "quadrant": quadrant, "translation": list(translation)}
    return np.array(ask(SCRIPT, json.dumps(of | {"rotation": list(rotation), "pairs": np.asarray(pairs).tolist()})))


@jax.jit
def _around(obstacle, start, end):
    return obstacle.around(start, end)


def compared(obstacle, pairs, theirs) -> tuple[np.ndarray, np.ndarray]:
    """How much longer theirs are [m], and the angle between the directions at the start [deg]."""
    line = _around(obstacle, *(vector(np.asarray(pairs)[:, k]) for k in (0, 1)))
    out = np.asarray(line.at_start.array())
    cosine = np.einsum("ij,ij->i", out, theirs[:, 2:5]) / np.linalg.norm(out, axis=1)
    return theirs[:, 0] - np.asarray(line.length), np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def patellas_place(flexion: np.ndarray, point) -> np.ndarray:
    """Points of a patella that rolls about the cylinder somewhat ahead of the knee's angle, in the femur's frame."""
    turn = Rotation.from_euler("z", -1.1 * flexion[:, None])
    return np.array([0.0106, -0.4188, 0.0]) + turn.apply(np.array([0.034, 0.01, 0.0]) + np.asarray(point))


FLEXION = np.radians(np.linspace(0, 90, 19))
VASTI = {  # of DM.osim of OpenSim JAM: last point on the femur, insertion on the patella, radius of KnExt
    "vasint": ((0.03328, -0.23195, 0.01971), (0.00366, 0.02144, 0.0016), 0.0274),
    "vaslat": ((0.02994, -0.28838, 0.03752), (0.00174, 0.01814, 0.01319), 0.0295),
    "vasmed": ((0.03962, -0.3082, -0.01301), (0.00946, 0.0188, -0.01239), 0.0295),
}


@pytest.mark.parametrize("muscle", VASTI)
def test_vasti_over_their_cylinder_as_in_opensim(muscle):
    """From 0 to 90 deg: straight at first, then around the cylinder at the knee."""
    origin, insertion, radius = VASTI[muscle]
    pairs = [[p, origin] for p in patellas_place(FLEXION, insertion)]
    at = (0.0106, -0.4188, 0.0)
    theirs = in_opensim("cylinder", radius, pairs, translation=at, quadrant="x")
    wrap = Cylinder(vector(at), "femur", number(radius), vector((0, 0, 1)), vector((1, 0, 0)))
    longer, angle = compared(wrap, pairs, theirs)
    assert (theirs[:, 1] > 2).any()
    assert (theirs[:, 1] == 2).any()
    assert np.abs(longer).max() < 1e-4
    assert angle.max() < 0.5


LPFL: dict[str, Any] = {"translation": (0.0197, -0.4203, 0.0212), "rotation": (-0.1569051, 0.29286625, -0.28989919)}
LPFL_RADII = (0.02, 0.035, 0.013)


def lpfl_wrap() -> Ellipsoid:
    q = Rotation.from_euler("XYZ", LPFL["rotation"]).as_quat(scalar_first=True)
    return Ellipsoid(vector(LPFL["translation"]), "femur", vector(LPFL_RADII), Quaternion(*(number(c) for c in q)))


def test_short_wraps_over_an_ellipsoid_as_in_opensim():
    """Lines across the lateral condyle's ellipsoid, as the LPFL's strands run: theirs are in no shortest plane."""
    rng, at = np.random.default_rng(1), np.array(LPFL["translation"])
    starts = at + rng.uniform(-1, 1, (24, 3)) * [0.004, 0.012, 0.003] + [0.033, 0.0, 0.008]
    ends = at + rng.uniform(-1, 1, (24, 3)) * [0.004, 0.008, 0.003] + [-0.025, 0.0, 0.016]
    pairs = np.stack([starts, ends], axis=1)
    theirs = in_opensim("ellipsoid", LPFL_RADII, pairs, **LPFL)
    longer, angle = compared(lpfl_wrap(), pairs, theirs)

    wraps = theirs[:, 1] > 2
    assert wraps.sum() > 5
    assert np.abs(longer).max() < 1e-4
    assert angle.max() < 0.5


def test_lines_over_a_sphere_are_opensims():
    """Ends anywhere around it: lines that wrap, by little and by much, that miss it, and that start inside it."""
    rng, radius, at = np.random.default_rng(3), 0.02, np.array([0.01, -0.4, 0.02])
    pairs = at + rng.uniform(-0.05, 0.05, (100, 2, 3))
    theirs = in_opensim("sphere", radius, pairs, translation=at, rotation=(0.3, -0.2, 0.5))
    longer, angle = compared(Sphere(vector(at), "femur", number(radius)), pairs, theirs)
    wraps, inside = theirs[:, 1] > 2, (np.linalg.norm(pairs - at, axis=2) < radius).any(axis=1)
    more = theirs[:, 0] - np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1)
    assert min(wraps.sum(), (~wraps & ~inside).sum()) > 15
    assert inside.any()
    assert more.max() > 5e-3
    assert np.abs(longer).max() < 1e-9
    assert angle.max() < 1e-3


def wrap_set(*objects: str) -> str:
    return f'<WrapObjectSet name="set"><objects>{"".join(objects)}</objects></WrapObjectSet>'


CYLINDER = (
    '<WrapCylinder name="KnExt"><active>true</active><xyz_body_rotation>0.1 -0.2 0.3</xyz_body_rotation>'
    "<translation>0.01 -0.02 0.003</translation><quadrant>-y</quadrant><radius>0.02</radius></WrapCylinder>"
)
ELLIPSOID = (
    '<WrapEllipsoid name="ball"><xyz_body_rotation>0.4 0.2 -0.3</xyz_body_rotation><translation>0.02 0 0.01'
    "</translation><quadrant>all</quadrant><dimensions>0.01 0.02 0.015</dimensions></WrapEllipsoid>"
)
SPHERE = (
    '<WrapSphere name="sphere"><xyz_body_rotation>0.4 0.2 -0.3</xyz_body_rotation><translation>0.02 0.03 0.01'
    "</translation><quadrant>all</quadrant><radius>0.012</radius></WrapSphere>"
)
TORUS = '<WrapTorus name="torus"><inner_radius>0.01</inner_radius><outer_radius>0.02</outer_radius></WrapTorus>'
OFF = CYLINDER.replace("KnExt", "off").replace("<active>true", "<active>false")
HALF = ELLIPSOID.replace("ball", "half").replace(">all<", ">x<")
HALF_SPHERE = SPHERE.replace('"sphere"', '"dome"').replace(">all<", ">-y<")


def scene_of(folder: Path, *lines: tuple[str, str, tuple[str, ...]], side: str = "right"):
    """A scene with ligaments (name, bone, objects), and what was told; the femur has all objects above."""
    forces = "".join(
        ligament(
            name,
            (PATELLA, PT[0]),
            (bone, PT[1]),
            k=100,
            slack=0.05,
            more="".join(f"<PathWrap><wrap_object>{w}</wrap_object></PathWrap>" for w in over),
        )
        for name, bone, over in lines
    )
    text = model(forces=forces, meshes=False)
    here = '<Body name="femur_r">'
    assert here in text
    text = text.replace(here, here + wrap_set(CYLINDER, ELLIPSOID, SPHERE, TORUS, OFF, HALF, HALF_SPHERE), 1)
    text = as_left(text) if side == "left" else text
    report = import_osim(write_knee(folder / "model", text), folder / "scene", side=side)
    return load_scene(report.scene), report


def wrap_of(scene: Any, name: str) -> Any:
    """What an effect's lines run over."""
    return scene.effect(name).wrap


# Rows: OpenSim's y, z, x are proximal, lateral, anterior.
ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def test_cylinders_ellipsoids_and_spheres_are_taken_over(tmp_path):
    scene, report = scene_of(
        tmp_path,
        ("A1", FEMUR, ("KnExt",)),
        ("A2", FEMUR, ("KnExt",)),
        ("B1", TIBIA, ("ball",)),
        ("C1", FEMUR, ("off",)),
        ("D1", FEMUR, ("sphere",)),
    )
    turn = Rotation.from_euler("XYZ", (0.1, -0.2, 0.3)).as_matrix()
    a, b, c, d = (wrap_of(scene, name) for name in "abcd")
    assert c is None
    assert isinstance(a, Cylinder)
    assert isinstance(b, Ellipsoid)
    assert isinstance(d, Sphere)
    assert (d.body, float(d.radius)) == ("femur", 0.012)
    np.testing.assert_allclose(d.center.array(), ANATOMICAL @ [0.02, 0.03, 0.01], atol=1e-9)
    assert (a.body, b.body, float(a.radius)) == ("femur", "femur", 0.02)
    np.testing.assert_allclose(a.center.array(), ANATOMICAL @ [0.01, -0.02, 0.003], atol=1e-9)
    np.testing.assert_allclose(a.axis.array(), ANATOMICAL @ turn[:, 2], atol=1e-9)
    assert a.side is not None
    np.testing.assert_allclose(a.side.array(), -ANATOMICAL @ turn[:, 1], atol=1e-9)
    axes = ANATOMICAL @ Rotation.from_euler("XYZ", (0.4, 0.2, -0.3)).as_matrix()
    shape = axes @ np.diag(np.array([0.01, 0.02, 0.015]) ** -2) @ axes.T
    own = np.asarray(b.orientation.rotation().array())
    np.testing.assert_allclose(own @ np.diag(np.asarray(b.radii.array()) ** -2) @ own.T, shape, rtol=1e-6, atol=1e-3)
    assert any("cylinders are taken as endless" in note for note in report.notes)
    assert not any("not wrapped" in note for note in report.notes)


def test_a_left_knee_has_their_mirror_images(tmp_path):
    """OpenSim's z is to the right in every model: lateral of a right knee, medial of a left one."""
    lines = ("A1", FEMUR, ("KnExt",)), ("B1", TIBIA, ("ball",)), ("C1", FEMUR, ("sphere",))
    right, left = (scene_of(tmp_path / side, *lines, side=side)[0] for side in ("right", "left"))
    mirror = np.array([1.0, -1.0, 1.0])
    (a, b, c), (mirrored, other, last) = ([wrap_of(scene, name) for name in "abc"] for scene in (right, left))
    np.testing.assert_allclose(last.center.array(), mirror * c.center.array(), atol=1e-12)
    assert a.side is not None
    for name in ("center", "axis", "side"):
        seen, expected = (np.asarray(getattr(wrap, name).array()) for wrap in (mirrored, a))
        assert abs(expected[1]) > 1e-3
        np.testing.assert_allclose(seen, mirror * expected, atol=1e-12)
    shapes = []
    for wrap in (b, other):
        own = np.asarray(wrap.orientation.rotation().array())
        shapes.append(own @ np.diag(np.asarray(wrap.radii.array()) ** -2) @ own.T)
    np.testing.assert_allclose(shapes[1], np.outer(mirror, mirror) * shapes[0], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(other.center.array(), mirror * b.center.array(), atol=1e-12)


def test_wraps_that_a_scene_cannot_have_are_reported(tmp_path):
    scene, report = scene_of(
        tmp_path,
        ("A1", FEMUR, ("torus",)),
        ("A2", FEMUR, ("torus",)),
        ("B1", FEMUR, ("nothing",)),
        ("C1", FEMUR, ("half",)),
        ("D1", FEMUR, ("ball", "KnExt")),
        ("E1", FEMUR, ("dome", "sphere")),
    )
    assert [note for note in report.notes if "not wrapped" in note] == [
        "A1 to A2 (2 strands): not wrapped over torus (a <WrapTorus>)",
        "B1: not wrapped over nothing (the model has no such object)",
        "C1: not wrapped over half (of its sides only x)",
        "D1: not wrapped over KnExt (a line runs over one obstacle, here ball)",
        "E1: not wrapped over dome (of its sides only -y)",
    ]
    assert [wrap_of(scene, name) is None for name in "abcde"] == [True, True, True, False, False]


def test_the_vasti_of_a_published_model_wrap_each_over_their_own(dm_knee, tmp_path):
    report = import_osim(dm_knee / "DM.osim", tmp_path / "scene", side="right", quadriceps=100.0)
    scene = load_scene(report.scene)
    assert sorted(np.asarray(wrap_of(scene, "quadriceps").radius)) == [0.0274, 0.0295, 0.0295]
    assert wrap_of(scene, "lpfl").body == "femur"
    assert wrap_of(scene, "pt").body == "patella"
