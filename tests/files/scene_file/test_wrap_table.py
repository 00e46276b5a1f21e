"""wrap = {...} in scene files: for every line of force, for left knees, and what is said of mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_scene_files import LIGHT, load, refused

from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.geometry.wrapping.sphere import Sphere

CYLINDER = (
    'wrap = { type = "cylinder", body = "femur", center_mm = [100, 0, 15], axis = [0, 1, 0.2], radius_mm = 20 }\n'
)
ELLIPSOID = (
    'wrap = { type = "ellipsoid", body = "patella", center_mm = [10, 2, -3], radii_mm = [5, 8, 12], '
    "quaternion_wxyz = [0.8, 0.36, 0.48, 0.0] }\n"
)
SPHERE = 'wrap = { type = "sphere", body = "femur", center_mm = [100, 4, 15], radius_mm = 20 }\n'
ENDS = "insertion_mm = [[20, 0, -8], [20, 5, -8]]\norigin_m = [[0.22, 0.012, 0.035], [0.22, 0.02, 0.035]]\n"
ELASTIC = 'name = "band"\nbody = "femur"\nslack_length_mm = 143\n' + ENDS
TABLES = {
    "tendon": ELASTIC + "stiffness_N_per_m = 156\n",
    "toe_tendon": ELASTIC + "stiffness_N_per_m = 156\n",
    "viscoelastic_tendon": ELASTIC
    + "stiffness_N_per_m = 156\nmaxwell_stiffness_N_per_m = 100\nrelaxation_time_s = 0.1\n",
    "strands": ELASTIC + "stiffness_N_per_strain = 500\n",
    "prescribed_tension": 'name = "band"\nbody = "femur"\ntension_N = [10, 20]\n' + ENDS,
}


@pytest.mark.parametrize("kind", TABLES)
def test_every_line_of_force_may_wrap(toy: Path, kind: str) -> None:
    table = f"\n[[{kind}]]\n{TABLES[kind]}"
    band, straight = (load(toy, LIGHT + table + more).effect("band").line_element() for more in (CYLINDER, ""))
    assert band is not None
    assert straight is not None
    assert straight.wrap is None
    wrap = band.wrap
    assert isinstance(wrap, Cylinder)
    assert (wrap.body, wrap.side, float(wrap.radius)) == ("femur", None, 0.02)
    np.testing.assert_allclose(wrap.center.array(), [0.1, 0, 0.015])
    np.testing.assert_allclose(wrap.axis.array(), [0, 1, 0.2])


def strands_over(toy: Path, wrap: str, scene: str = LIGHT) -> Any:
    """What strands run over in a scene."""
    band: Any = load(toy, scene + "\n[[strands]]\n" + TABLES["strands"] + wrap).effect("band")
    return band.wrap


def test_each_line_may_have_its_own(toy: Path) -> None:
    own = CYLINDER.replace("radius_mm = 20", "radius_mm = [20, 25]").replace("}", ", side = [[0, 0, 1], [0, 0.1, 1]] }")
    wrap = strands_over(toy, own)
    np.testing.assert_allclose(wrap.radius, [0.02, 0.025])
    np.testing.assert_allclose(wrap.center.array(), [[0.1, 0, 0.015]] * 2)
    np.testing.assert_allclose(wrap.side.array(), [[0, 0, 1], [0, 0.1, 1]])


@pytest.mark.parametrize(("radius", "radii"), [("20", 0.02), ("[20, 25]", [0.02, 0.025])])
def test_a_sphere_has_a_centre_and_a_radius(toy: Path, radius: str, radii: Any) -> None:
    wrap = strands_over(toy, SPHERE.replace("radius_mm = 20", f"radius_mm = {radius}"))
    assert isinstance(wrap, Sphere)
    assert wrap.body == "femur"
    np.testing.assert_array_equal(wrap.radius, radii)
    np.testing.assert_allclose(
        wrap.center.array(), [[0.1, 0.004, 0.015]] * 2 if np.ndim(radii) else [0.1, 0.004, 0.015]
    )


LEFT = 'side = "left"\n'


def test_in_a_left_knee_it_is_the_mirror_image(toy: Path) -> None:
    """Left data in their own axes, y to the left: what has y mirrored is the right knee's."""
    turn = np.array([0.8, 0.36, 0.48, 0.0])
    right = strands_over(toy, ELLIPSOID)
    both = LIGHT.replace("schema = 1", "schema = 1\n" + LEFT).replace(
        'name = "toy"', 'name = "toy"\naxes = { world_medial_lateral = "y" }'
    )
    mirrored = ELLIPSOID.replace("[10, 2, -3]", "[10, -2, -3]")
    # A mirrored turn: its axis, a pseudovector, has x and z turned round where y is mirrored.
    mirrored = mirrored.replace("[0.8, 0.36, 0.48, 0.0]", str([0.8, -0.36, 0.48, -0.0]))
    left = strands_over(toy, mirrored, both)
    assert isinstance(left, Ellipsoid)
    np.testing.assert_allclose(left.center.array(), right.center.array(), atol=1e-15)
    shapes = []
    for wrap in (left, right):  # the matrix of its quadratic form
        axes = np.asarray(wrap.orientation.rotation().array())
        shapes.append(axes @ np.diag(np.asarray(wrap.radii.array()) ** -2) @ axes.T)
        assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(shapes[0], shapes[1], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose([getattr(right.orientation, k) for k in "wxyz"], turn, atol=1e-12)
    ball = strands_over(toy, SPHERE.replace("[100, 4, 15]", "[100, -4, 15]"), both)
    np.testing.assert_allclose(ball.center.array(), [0.1, 0.004, 0.015], atol=1e-15)


MISTAKES = [
    ('"cylinder"', '"torus"', "wrap: type is 'torus'; expected: table: obstacle that the lines wrap over"),
    ('type = "cylinder", ', "", "wrap: type is missing"),
    ("radius_mm = 20", "radius_mm = 0", "wrap.radius_mm: found 0; expected: a positive number"),
    ("radius_mm = 20", "radius_mm = [20, 20, 20]", "wrap: 3 obstacles for 2 lines; expected: 1 or 2"),
    ("radius_mm = 20", "radius_mm = [20, 20], side = [[0, 0, 1], [0, 0, 1], [0, 0, 1]]", "radius_m has 2 values"),
    ("axis = [0, 1, 0.2]", "axis = [0, 0, 0]", "wrap.axis: found the zero vector"),
    ("radius_mm = 20", "radius_mm = 20, side = [0, 2, 0.4]", "the side [0.0, 2.0, 0.4] is along the axis"),
    ('body = "femur", center', 'body = "ground", center', "wrap.body: found 'ground'; expected: one of"),
    ("center_mm = [100, 0, 15], ", "", "wrap.center_m: is missing"),
    ("radius_mm = 20", "radius_m = 28", "radius_m is 28 m; expected: at most 0.2 m"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), MISTAKES)
def test_mistakes_are_reported_with_their_place(toy: Path, old: str, new: str, said: str) -> None:
    assert old in CYLINDER
    message = refused(toy, LIGHT + "\n[[strands]]\n" + TABLES["strands"] + CYLINDER.replace(old, new))
    assert "[[strands]]" in message
    assert said in message, message


SPHERE_MISTAKES = [
    ("radius_mm = 20", "radius_mm = -20", "wrap.radius_mm: found -20; expected: a positive number"),
    ("radius_mm = 20", "radius_m = 28", "radius_m is 28 m; expected: at most 0.2 m"),
    ("radius_mm = 20", "radius_mm = [20, 20, 20]", "wrap: 3 obstacles for 2 lines; expected: 1 or 2"),
    ("radius_mm = 20", "radius_mm = 20, axis = [0, 1, 0]", "wrap.axis"),
]


@pytest.mark.parametrize(("old", "new", "said"), SPHERE_MISTAKES)
def test_mistakes_of_a_sphere_are_reported(toy: Path, old: str, new: str, said: str) -> None:
    assert old in SPHERE
    message = refused(toy, LIGHT + "\n[[strands]]\n" + TABLES["strands"] + SPHERE.replace(old, new))
    assert said in message, message


def test_lists_of_an_ellipsoid_that_do_not_match_are_reported(toy: Path) -> None:
    two = ELLIPSOID.replace("[10, 2, -3]", "[[10, 2, -3], [11, 2, -3]]").replace(
        "radii_mm = [", "radii_mm = [[9, 9, 9], [8, 8, 8], ["
    )
    message = refused(toy, LIGHT + "\n[[strands]]\n" + TABLES["strands"] + two.replace("], quat", "]], quat"))
    assert "center_m has 2 values and radii_m has 3" in message


DEEP = {  # by hand: two lines end 5 mm from an axis, or from a sphere's centre; one ends in an ellipsoid's middle
    "15 mm": 'type = "cylinder", body = "femur", center_mm = [220, -7, 30], axis = [0, 3, 0], radius_mm = 20',
    "14 mm": 'type = "sphere", body = "femur", center_mm = [220, 15, 39], radius_mm = 19',
    "5 mm": 'type = "ellipsoid", body = "patella", center_mm = [20, 5, -8], radii_mm = [5, 8, 12]',
}


@pytest.mark.parametrize("depth", DEEP)
def test_an_end_inside_its_obstacle_is_reported(toy: Path, depth: str) -> None:
    """The line would run straight through it."""
    text = LIGHT + "\n[[strands]]\n" + TABLES["strands"] + f"wrap = {{ {DEEP[depth]} }}\n"
    message = refused(toy, text)
    assert f"an end of band within what it wraps over at the start, where it runs straight, is {depth}" in message
    assert "--allow most_depth_in_wrap_mm=" in message
    load(toy, text.replace("limits = {", "limits = { most_depth_in_wrap_mm = 16,"))
