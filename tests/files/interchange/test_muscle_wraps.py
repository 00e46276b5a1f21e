"""Muscles that wrap: how much longer their paths are, against geometry and OpenSim."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from knee_models import FEMUR, PATELLA, model, point
from opensim_process import ask
from test_muscle_path import LENGTHS

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.interchange.osim_knee import find_knee
from pftwin.files.interchange.osim_model import read_model
from pftwin.files.interchange.osim_wraps import Wraps, wraps_of

RADIUS = 0.03
ROWS = [{"knee_flex_r": 0.2, "pf_tx_r": x, "pf_ty_r": y} for x, y in ((0.06, 0.05), (0.05, 0.0), (0.03, -0.03))]


def cylinder(turn: str = "0 0 0", **other: object) -> str:
    tags = {"translation": "0.01 0.03 0.005", "xyz_body_rotation": turn, "quadrant": "x", "radius": RADIUS, **other}
    inside = "".join(f"<{tag}>{value}</{tag}>" for tag, value in {"active": "true", "length": 0.3, **tags}.items())
    return f'<WrapCylinder name="roll">{inside}</WrapCylinder>'


def written(folder: Path, wrap: str, over: str = "roll", more: str = "") -> Path:
    """The knee's model with a muscle from the femur's back, over an object on the femur, to the patella."""
    points = point("a", FEMUR, (0.0, 0.2, 0.0)) + point("b", FEMUR, (0.03, 0.12, 0.0)) + point("c", PATELLA, (0, 0, 0))
    wrapping = f'<PathWrap name="w"><wrap_object>{over}</wrap_object>{more}</PathWrap>'
    muscle = (
        '<Millard2012EquilibriumMuscle name="m"><GeometryPath name="geometrypath"><PathPointSet><objects>'
        f"{points}</objects></PathPointSet><PathWrapSet><objects>{wrapping}</objects></PathWrapSet></GeometryPath>"
        "</Millard2012EquilibriumMuscle>"
    )
    held = f'<WrapObjectSet name="wrapobjectset"><objects>{wrap}</objects></WrapObjectSet>'
    text = model(forces=muscle, meshes=False).replace("<defaults>", '<defaults><WrapObjectSet name="default"/>')
    text = text.replace('<Body name="femur_r">', f'<Body name="femur_r">{held}', 1)
    (folder / "wraps.osim").write_text(text)
    return folder / "wraps.osim"


def wraps(folder: Path, *given: str, **more: str):
    root = read_osim(written(folder, *given, **more))
    return wraps_of(next(root.all("Millard2012EquilibriumMuscle")), Wraps(find_knee(read_model(root))))


def test_half_a_turn_around_a_cylinder_is_its_half_circumference(tmp_path):
    """With both ends beside the axis at the cylinder's far side: two tangents along -x, and half a circle."""
    ((wrap,), _) = wraps(tmp_path, cylinder())
    at = np.array([0.01, 0.03, 0.005])
    start, end = (at + np.array([(-0.1, y, 0.0)]) for y in (RADIUS, -RADIUS))
    assert wrap.part == "femur"
    assert wrap.adds(start, end) == pytest.approx(0.2 + np.pi * RADIUS - 2 * RADIUS, abs=1e-6)
    assert wrap.adds(start, start + np.array([0.0, 0.05, 0.0])) == pytest.approx(0, abs=1e-7)
    ((other,), _) = wraps(tmp_path, cylinder("0 0 1.5707963267948966", quadrant="-Y"))  # its -y is the femur's x
    assert other.adds(start, end) == pytest.approx(wrap.adds(start, end), abs=1e-6)
    ((nearer,), _) = wraps(tmp_path, cylinder(quadrant="all"))
    aside = (at + np.array([(x, 0.01, 0.0)]) for x in (-0.05, 0.05))  # 10 mm beside the axis
    reach, apart = np.arccos(RADIUS / np.hypot(0.05, 0.01)), np.pi - 2 * np.arctan2(0.01, 0.05)
    over = 2 * np.sqrt(0.05**2 + 0.01**2 - RADIUS**2) + RADIUS * (apart - 2 * reach)
    assert nearer.adds(*aside) == pytest.approx(over - 0.1, abs=1e-6)


def test_a_turned_cylinder_is_as_opensim_has_it(tmp_path):
    lengths = ask(LENGTHS, written(tmp_path, cylinder("0.2 -0.3 0.1")), json.dumps(ROWS), '["m"]')
    straight = ask(LENGTHS, written(tmp_path, cylinder("0.2 -0.3 0.1", active="false")), json.dumps(ROWS), '["m"]')
    ((wrap,), _) = wraps(tmp_path, cylinder("0.2 -0.3 0.1"))
    start = np.tile([0.03, 0.12, 0.0], (len(ROWS), 1))
    end = np.array([[row["pf_tx_r"], row["pf_ty_r"], 0.001] for row in ROWS])  # pf_tz_r is 1 mm by default
    added = np.subtract(lengths, straight)[:, 0]
    np.testing.assert_allclose(wrap.adds(start, end), added, atol=2e-5)
    assert added.max() > 1e-3


def test_what_counts_between_which_points(tmp_path):
    def covered(said: str = "") -> list[bool]:
        """Of each piece of a path of four points."""
        ((wrap,), _) = wraps(tmp_path, cylinder(), more=said)
        return [wrap.between.covers(k, k + 1) for k in range(3)]

    assert covered() == [True, True, True]
    assert covered("<range>2 3</range>") == [False, True, False]
    assert covered("<range>-1 2</range>") == [True, False, False]
    assert covered("<range>3 -1</range>") == [False, False, True]
    assert wraps(tmp_path, cylinder(active="false")) == ([], [])
    (said,) = wraps(tmp_path, cylinder(), "rolls")[1]
    assert "rolls" in said
    (said,) = wraps(tmp_path, cylinder(quadrant="z"))[1]
    assert "roll" in said


BALLS = {
    "WrapEllipsoid": f"<dimensions>{RADIUS} {RADIUS} {RADIUS}</dimensions>",
    "WrapSphere": f"<radius>{RADIUS}</radius>",
}


@pytest.mark.parametrize("tag", BALLS)
def test_a_line_over_a_ball_is_two_tangents_and_an_arc(tmp_path, tag):
    """A sphere, or an ellipsoid of three like radii; both ends as far away, at right angles; at 50 mm it misses."""
    ball = f'<{tag} name="roll"><translation>0.01 0.03 0.005</translation>{BALLS[tag]}</{tag}>'
    ((wrap,), left) = wraps(tmp_path, ball)
    assert not left
    at = np.array([[0.01, 0.03, 0.005]])
    for far in (0.05, 0.04, 0.032):
        over = 2 * np.sqrt(far**2 - RADIUS**2) + RADIUS * (np.pi / 2 - 2 * np.arccos(RADIUS / far))
        expected = over - far * np.sqrt(2) if far < RADIUS * np.sqrt(2) else 0.0
        found = wrap.adds(at + np.array([far, 0.0, 0.0]), at + np.array([0.0, 0.0, far]))
        assert found == pytest.approx(expected, abs=1e-6)


def test_objects_that_cannot_be_are_refused_with_their_line(tmp_path):
    with pytest.raises(InputError, match=r"wraps.osim, line \d+: <radius> is"):
        wraps(tmp_path, cylinder(radius=0))
