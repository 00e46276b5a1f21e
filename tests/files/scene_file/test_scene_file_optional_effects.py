"""Scene files: friction, tendons with a toe region, viscoelastic tendons; and that nobody pays who has none of them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from toy_mesh_scenes import SCENES, foundation
from toy_scene_files import LIGHT, SCENE, changed, load, refused, same

import pftwin
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.mesh_sphere_contact import RoughMeshSphereContact
from pftwin.model.effects.mesh_volume_contact import RoughMeshVolumeContact
from pftwin.model.effects.sphere_contact import RoughSphereContact
from pftwin.model.effects.tendon import ToeTendon
from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon

LAW = 'law = { type = "flores", contact_stiffness = 2e8, restitution = 0.6 }\n'
FRICTION = "friction = { coefficient = 0.05, slip_speed_m_per_s = 0.002 }\n"


def test_friction_of_a_patch(toy: Path) -> None:
    plain, scene = load(toy, LIGHT), load(toy, changed(LAW, LAW + FRICTION))
    contact = scene.contact
    assert isinstance(contact, RoughSphereContact)
    assert (float(contact.friction.coefficient), float(contact.friction.slip_speed)) == (0.05, 0.002)
    same(contact.alone(), plain.contact)
    assert contact.name == "contact"
    default = load(toy, changed(LAW, LAW + "friction = { coefficient = 0.05 }\n")).contact
    assert isinstance(default, RoughSphereContact)
    assert float(default.friction.slip_speed) == 1e-3


@pytest.mark.parametrize(("method", "kind"), [("nearest", RoughMeshSphereContact), ("volume", RoughMeshVolumeContact)])
def test_friction_of_a_sphere_on_a_mesh(toy: Path, method: str, kind: type) -> None:
    contact = load(toy, SCENES[method] + FRICTION).effects[-1]
    assert type(contact) is kind
    assert float(contact.friction.coefficient) == 0.05  # type: ignore[attr-defined]
    same(contact.alone(), load(toy, SCENES[method]).effects[-1])  # type: ignore[attr-defined]


def test_friction_is_refused_where_there_is_no_sphere(toy: Path) -> None:
    message = refused(toy, SCENES["contours"] + FRICTION)
    assert 'friction with method = "contours"' in message
    assert 'expected: method = "volume" or "nearest"' in message
    assert "friction: unknown field" in refused(toy, foundation(more=FRICTION))
    layers, friction = load(toy, foundation()).effects[-1], Friction(np.asarray(0.1), np.asarray(1e-3))
    with pytest.raises(pftwin.InputError, match=r"friction for 'elastic_foundation' \(ElasticFoundation\); expected"):
        layers.with_friction(friction)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("friction = { coefficient = -0.1 }", "coefficient: found -0.1; expected: zero or"),
        ("friction = { coefficient = 0.1, slip_speed_m_per_s = 0 }", "slip_speed_m_per_s: found 0; expected: "),
        ("friction = { slip_speed_m_per_s = 0.01 }", "coefficient: is missing; expected: coefficient of friction"),
        ("friction = 0.1", "friction: found 0.1"),
    ],
)
def test_what_is_wrong_with_friction_is_said(toy: Path, wrong: str, message: str) -> None:
    assert message in refused(toy, changed(LAW, f"{LAW}{wrong}\n"))


ENDS = "insertion_mm = [-20, 0, -8]\norigin_mm = [-70, 10, 45]\n"
TOE = f"""
[[toe_tendon]]
name = "patellar"
body = "tibia"
stiffness_N_per_m = 2000
slack_length_mm = 70
toe_strain = 0.05
damping_time_s = 0.01
{ENDS}"""
VISCOELASTIC = f"""
[[viscoelastic_tendon]]
name = "patellar"
body = "tibia"
stiffness_N_per_m = 629
maxwell_stiffness_N_per_m = 300
relaxation_time_s = 0.5
slack_length_mm = 71.4
{ENDS}"""


def test_a_tendon_with_a_toe_region(toy: Path) -> None:
    tendon = load(toy, LIGHT + TOE).effect("patellar")
    assert isinstance(tendon, ToeTendon)
    found = [float(a) for a in (tendon.stiffness, tendon.slack_length, tendon.toe_strain, tendon.damping)]
    np.testing.assert_allclose(found, [2000, 0.07, 0.05, 20])
    np.testing.assert_allclose(tendon.insertion.array(), [-0.02, 0, -0.008])
    np.testing.assert_allclose(tendon.origin.array(), [-0.07, 0.01, 0.045])
    assert tendon.body == "tibia"
    message = refused(toy, LIGHT + TOE + "damping_N_s_per_m = 3\n")
    assert "both damping_N_s_per_m and damping_time_s are given" in message
    assert "toe_strain: found 0" in refused(toy, LIGHT + TOE.replace("0.05", "0"))


def test_a_viscoelastic_tendon(toy: Path) -> None:
    tendon = load(toy, LIGHT + VISCOELASTIC).effect("patellar")
    assert isinstance(tendon, ViscoelasticTendon)
    found = (tendon.stiffness, tendon.maxwell_stiffness, tendon.relaxation_time, tendon.slack_length)
    np.testing.assert_allclose([float(a) for a in found], [629, 300, 0.5, 0.0714])
    assert "relaxation_time_s: found 0" in refused(toy, LIGHT + VISCOELASTIC.replace("_s = 0.5", "_s = 0"))
    assert "maxwell_stiffness_N_per_m: found -300" in refused(toy, LIGHT + VISCOELASTIC.replace("= 300", "= -300"))
    absent = LIGHT + VISCOELASTIC.replace("relaxation_time_s = 0.5\n", "")
    assert "relaxation_time_s: is missing; expected: relaxation time tau" in refused(toy, absent)


@pytest.mark.parametrize("table", [TOE, VISCOELASTIC])
def test_lists_make_groups_of_them(toy: Path, table: str) -> None:
    group = load(toy, LIGHT + table.replace("[-20, 0, -8]", "[[-20, 0, -8], [-20, 5, -8]]")).effect("patellar")
    assert group.stiffness.shape == group.slack_length.shape == (2,)  # type: ignore[attr-defined]
    np.testing.assert_allclose(group.insertion.y, [0, 0.005])  # type: ignore[attr-defined]
    wrong = table.replace("[-20, 0, -8]", "[[-20, 0, -8], [-20, 5, -8], [-20, 9, -8]]")
    wrong = wrong.replace("[-70, 10, 45]", "[[-70, 10, 45], [-70, 5, 45]]")
    assert "one value for all members, or one for each" in refused(toy, LIGHT + wrong)


def test_a_parameter_that_went_wrong_later_is_named() -> None:
    import equinox as eqx
    from scenes import knee

    scene = knee(5)
    plain = scene.contact
    assert plain is not None
    rough = plain.with_friction(Friction(np.asarray(-0.1), np.asarray(1e-3)))
    with pytest.raises(pftwin.InputError, match=r"contact\.friction\.coefficient: found -0\.1; expected: zero or"):
        pftwin.simulate(scene.with_effect(rough))
    rough = eqx.tree_at(lambda c: (c.friction.coefficient, c.friction.slip_speed), rough, (0.1, 0.0))
    with pytest.raises(pftwin.InputError, match=r"contact\.friction\.slip_speed: found 0; expected: a positive"):
        pftwin.simulate(scene.with_effect(rough))


@pytest.mark.slow
def test_all_of_them_run_from_a_file(toy: Path) -> None:
    """One knee with all three: it starts in equilibrium, closes its budget and reports them with their units."""
    begin, end = (LIGHT.index(a) for a in ('[[tendon]]\nname = "patellar_tendon"', "[contact]"))
    text = LIGHT[:begin] + TOE.replace('"patellar"', '"toe"') + VISCOELASTIC.replace("= 629", "= 300") + LIGHT[end:]
    result = pftwin.simulate(load(toy, text.replace(LAW, LAW + FRICTION)))
    assert result.equilibrium.residual < 1e-6
    data = result.to_dataset()
    for name, unit in (("contact_friction_medial", "N"), ("toe_tension", "N"), ("patellar_dashpot_stretch", "m")):
        assert data[name].attrs["units"] == unit
        assert np.isfinite(data[name]).all()
    assert np.abs(result.energies.budget_error).max() < 0.02 * np.abs(result.energies.work).max()
    assert float(data["contact_friction_medial"].max() + data["contact_friction_lateral"].max()) > 0


def test_the_documented_tables_load(toy: Path) -> None:
    """Each block of the page, in the place of the small knee's contact or beside its tendons."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "effects.md").read_text()
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    kinds = {}
    for block in blocks:
        text = SCENE[: SCENE.index("[contact]")] + block if "[contact]" in block else LIGHT + block
        for effect in load(toy, text).effects:
            kinds[effect.name] = type(effect).__name__
    assert kinds["contact"] in ("SphereContact", "RoughSphereContact")
    assert (kinds["graft"], kinds["patellar_ligament"]) == ("ToeTendon", "ViscoelasticTendon")
    assert (kinds["mpfl"], kinds["lpfl"]) == ("StrandGroup", "StrandGroup")
    assert sum("friction =" in block for block in blocks) == 1


ABSENT = """
import sys
sys.path[:0] = ["tests", "tests/dynamics"]
from pftwin.base.runtime import configure
configure()
from test_programs import program, size
from pftwin import rig
scene = rig.case(1)
before = size(scene)
kinds = ("mesh_contact", "mesh_sphere_contact", "mesh_volume_contact", "viscoelastic_tendon")
print([k for k in kinds if f"pftwin.model.effects.{k}" in sys.modules])
import importlib
for k in kinds:
    importlib.import_module(f"pftwin.model.effects.{k}")
print(before == size(scene), any("frict" in str(p) or "dashpot" in str(p) for p in [program(scene)]))
"""


@pytest.mark.slow
def test_a_scene_without_them_neither_imports_them_nor_has_an_equation_of_them() -> None:
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", ABSENT], capture_output=True, text=True, check=True, timeout=300, cwd=root
    )
    assert done.stdout.split("\n")[:2] == ["[]", "True False"]


def test_a_scene_file_without_them_does_not_import_them(toy: Path) -> None:
    (toy / "plain.toml").write_text(SCENE)
    code = (
        "import sys, pftwin; pftwin.load_scene(sys.argv[1]);"
        "late = ('mesh_contact', 'mesh_sphere_contact', 'mesh_volume_contact', 'viscoelastic_tendon');"
        "print([m for m in sys.modules if m.endswith(late)])"
    )
    command = [sys.executable, "-c", code, str(toy / "plain.toml")]
    assert subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout.strip() == "[]"
