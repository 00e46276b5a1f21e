"""Scene files: the surfaces, laws, tendons and strands that their tables build."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from toy_scene_files import (
    LIGHT,
    SCENE,
    changed,
    load,
    refused,
    same,
)

from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.effects.contact_law import Hertz, HuntCrossley
from pftwin.model.effects.tendon import Tendon


def test_a_patch_by_its_coefficients_is_that_patch(toy: Path) -> None:
    contact = load(toy, LIGHT).contact
    assert contact is not None
    a, b = 0.5, -0.25
    u, v = 0.024 * a, 0.002 + 0.02 * b
    height = 0.004 + 0.001 * a - 0.009 * a * a + 0.0005 * b + 0.0002 * a * b + 0.003 * b * b
    assert float(contact.surface.height(np.asarray(u), np.asarray(v))) == pytest.approx(height, abs=1e-12)


@pytest.mark.parametrize(
    ("law", "kind"),
    [
        ('{ type = "hertz", contact_stiffness = 2e8, hertz_exponent = 1 }', Hertz),
        ('{ type = "hunt_crossley", contact_stiffness = 2e8, dissipation_s_per_m = 0.3 }', HuntCrossley),
    ],
)
def test_contact_laws(toy: Path, law: str, kind: type) -> None:
    contact = load(toy, changed('{ type = "flores", contact_stiffness = 2e8, restitution = 0.6 }', law)).contact
    assert contact is not None
    assert type(contact.law) is kind


def test_the_rigs_smooth_implant_can_be_the_surface(toy: Path) -> None:
    text = SCENE[: SCENE.index("[contact.surface]")] + '[contact.surface]\nimplant = "rig"\n'
    contact = load(toy, text).contact
    assert contact is not None
    same(contact.surface, rig_implant())


GROUP = """
[[tendon]]
name = "retinaculum"
body = "femur"
stiffness_N_per_m = [100, 200]
slack_length_m = 0.05
insertion_m = [[0, 0.01, 0], [0, -0.01, 0]]
origin_mm = [[10, 50, 20], [10, -50, 20]]
"""


def test_lists_make_a_group(toy: Path) -> None:
    group = load(toy, LIGHT + GROUP).effect("retinaculum")
    assert isinstance(group, Tendon)
    np.testing.assert_allclose(group.stiffness, [100, 200])
    np.testing.assert_allclose(group.slack_length, [0.05, 0.05])
    np.testing.assert_allclose(group.damping, [0, 0])
    np.testing.assert_allclose(group.origin.y, [0.05, -0.05])


STRANDS = '\n[[strands]]\nname = "ligament"\nbody = "tibia"\ntoe_strain = 0.06\ndamping_time_s = 0.003\n'


def test_strands_from_lists_json_and_csv_are_the_same(toy: Path) -> None:
    inline = "stiffness_N_per_strain = [490, 500]\nslack_length_mm = [75, 76]\n"
    inline += "insertion_m = [[-0.01, 0, 0], [-0.01, 0.002, 0]]\norigin_m = [[-0.07, 0, 0.04], [-0.07, 0.001, 0.04]]\n"
    a = {"points": [["patella", [-0.01, 0, 0]], ["tibia", [-0.07, 0, 0.04]]]}
    b = {"points": [["tibia", [-0.07, 0.001, 0.04]], ["patella", [-0.01, 0.002, 0]]]}
    other = {"points": [["femur", [0, 0, 0]], ["patella", [0, 0, 0]]]}
    sizes = [{"linear_stiffness_N_per_strain": k, "slack_length_m": s} for k, s in ((490, 0.075), (500, 0.076))]
    strands = {"PT1": a | sizes[0], "PT2": b | sizes[1], "MPFL1": other | sizes[0], "XX": a | sizes[0]}
    (toy / "strands.json").write_text(json.dumps(strands))
    header = "name,stiffness_N_per_strain,slack_length_m," + ",".join(
        f"{e}_{k}_m" for e in ("insertion", "origin") for k in "xyz"
    )
    rows = "PT1,490,0.075,-0.01,0,0,-0.07,0,0.04\nPT2,500,0.076,-0.01,0.002,0,-0.07,0.001,0.04\n"
    (toy / "strands.csv").write_text(f"{header}\n{rows}")
    listed = load(toy, LIGHT + STRANDS + inline)
    same(load(toy, LIGHT + STRANDS + 'file = "strands.json"\nselect = ["PT*"]\n'), listed)
    same(load(toy, LIGHT + STRANDS + 'file = "strands.csv"\n'), listed)
    message = refused(toy, LIGHT + STRANDS + 'file = "strands.json"\nselect = ["QT*"]\n')
    assert "[[strands]] number 1 (ligament), file: strands.json: no strand from the patella to the tibia" in message
    message = refused(toy, LIGHT + STRANDS + inline + 'file = "strands.csv"\n')
    assert "both file and stiffness_N_per_strain are given" in message
    (toy / "strands.csv").write_text(f"{header}\n{rows.replace('0.076', 'long')}")
    assert "strands.csv, line 3: a cell is missing or no number" in refused(
        toy, LIGHT + STRANDS + 'file = "strands.csv"\n'
    )
    (toy / "strands.csv").write_text(f"{header}\n{rows.replace('500', '-500')}")
    assert "strand 'PT2': stiffness -500" in refused(toy, LIGHT + STRANDS + 'file = "strands.csv"\n')


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,{c}\nPT1,{v}\nPT1,{v}\n", "strands.csv: strands that occur twice: PT1"),
        ("name,{c},slack_length_m\nPT1,{v},2\n", "strands.csv: columns that occur twice: slack_length_m"),
        ('name,{c}\n"PT1,{v}\nPT2,{v}\n', "strands.csv, line 2: a cell is missing or no number"),
        ("# nothing\n", "strands.csv: no header line"),
        ("name,{c}\n" + 200_000 * "P" + ",{v}\n", "strands.csv, line 2: a cell of more than 131,072 characters"),
        (
            '{{"PT1": {{"points": []}}, "PT1": {{"points": []}}}}',
            "strands.json: names in one object that occur twice: PT1",
        ),
    ],
)
def test_files_of_strands_that_say_a_thing_twice_or_nothing(toy: Path, text: str, words: str) -> None:
    columns = "stiffness_N_per_strain,slack_length_m," + ",".join(
        f"{end}_{axis}_m" for end in ("insertion", "origin") for axis in "xyz"
    )
    name = "strands.json" if text.startswith("{{") else "strands.csv"
    (toy / name).write_text(text.format(c=columns, v="490,0.075,-0.01,0,0,-0.07,0,0.04"))
    assert words in refused(toy, LIGHT + STRANDS + f'file = "{name}"\n')


TENSION = '\n[[prescribed_tension]]\nname = "muscles"\nbody = "femur"\nfile = "tension.csv"\n'


CONSTANT = (
    '\n[[prescribed_tension]]\nname = "muscles"\nbody = "femur"\ntension_N = [12, 7]\n'
    "insertion_mm = [[20, 0, -8], [18, 5, -7]]\norigin_m = [[0.2, 0.01, 0.05], [0.21, 0.03, 0.04]]\n"
)


def test_constant_tensions_need_no_file(toy: Path) -> None:
    muscles = load(toy, LIGHT + CONSTANT).effect("muscles")
    for time in (-3.0, 0.0, 0.37, 50.0):
        tension, origin = muscles.at(time)  # type: ignore[attr-defined]
        np.testing.assert_allclose(tension, [12, 7])
        np.testing.assert_allclose(origin.z, [0.05, 0.04])
    np.testing.assert_allclose(muscles.insertion.y, [0, 5e-3])  # type: ignore[attr-defined]
    assert "neither file nor tension_N" in refused(toy, LIGHT + CONSTANT.replace("tension_N = [12, 7]", ""))
    assert "insertion_m has 2 for 1 tensions" in refused(toy, LIGHT + CONSTANT.replace("[12, 7]", "[12]"))
    assert "without ends" in refused(toy, LIGHT + CONSTANT.partition("insertion_mm")[0])
    assert "expected: file or tension_N" in refused(toy, LIGHT + CONSTANT + 'file = "tension.csv"\n')


def test_prescribed_tensions(toy: Path) -> None:
    times = np.arange(11) * 0.04
    header = "time_s,vas_tension_N,vas_via_femur_x_m,vas_via_femur_y_m,vas_via_femur_z_m"
    rows = [f"{t:.4f},{10 + t},{0.2 + t},0,0.05" for t in times]
    (toy / "tension.csv").write_text("\n".join([header, *rows]) + "\n")
    insertion = "insertion_mm = [20, 0, -8]\n"
    muscles = load(toy, LIGHT + TENSION + insertion).effect("muscles")
    tension, origin = muscles.at(0.1)  # type: ignore[attr-defined]
    np.testing.assert_allclose(tension, [10.1])
    np.testing.assert_allclose(origin.x, [0.3])
    np.testing.assert_allclose(muscles.insertion.z, [-0.008])  # type: ignore[attr-defined]
    assert "no column vas_insertion_x_m, and no insertion_m in the scene file" in refused(toy, LIGHT + TENSION)
    (toy / "tension.csv").write_text("\n".join([header, *rows[:-2]]) + "\n")
    assert "tensions for the whole motion, 0 s to 0.4 s" in refused(toy, LIGHT + TENSION + insertion)
    (toy / "tension.csv").write_text("\n".join([header, *rows]).replace("10.04", "-3") + "\n")
    assert "column 'vas_tension': row 2 holds -3" in refused(toy, LIGHT + TENSION + insertion)
