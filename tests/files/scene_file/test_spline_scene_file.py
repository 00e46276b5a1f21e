"""The spline in scene files and on the command line: asked for, written, read again, and refused where it cannot be."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from toy_scene_files import LIGHT, SCENE, changed, load, write_toy
from typer.testing import CliRunner

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.cli.program import app
from pftwin.files.scene_file import load_scene
from pftwin.geometry.mesh.mesh import save_mesh
from pftwin.geometry.patch.fit import name_of
from pftwin.geometry.patch.implant import RIG_RIM, RIG_TOLERANCE, rig_implant
from pftwin.geometry.patch.spline import SplinePatch
from pftwin.model.scene import Scene
from pftwin.rig.scene_template import write_example

SURFACE = SCENE[SCENE.index("[contact.surface]") :]
SPLINE = SURFACE.replace('degree = "P5"', 'kind = "spline"')
BEFORE = SCENE[: SCENE.index("[contact.surface]")]
U, V = jnp.array([0.0, 0.01, -0.012, 0.03]), jnp.array([0.002, -0.01, 0.015, 0.03])  # the last one beyond the edge


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("spline")
    write_toy(folder)
    return folder


@pytest.fixture(scope="module")
def fitted(toy: Path) -> SplinePatch:
    return surface(load(toy, BEFORE + SPLINE))


def surface(scene: Scene) -> SplinePatch:
    assert scene.contact is not None
    assert isinstance(scene.contact.surface, SplinePatch)
    return scene.contact.surface


def table(patch: SplinePatch) -> str:
    """The patch by its coefficients; its chart is a plane."""
    from pftwin.base.spatial import Quaternion

    q, o = Quaternion.from_rotation(patch.chart.axes), patch.chart.origin
    return "\n".join(
        [
            "[contact.surface]",
            f"spline_coefficients_m = {np.asarray(patch.coefficients).tolist()}",
            f"center_m = {[float(x) for x in patch.center]}",
            f"half_size_m = {[float(x) for x in patch.half_size]}",
            f'chart = {{ type = "plane", origin_m = {[float(o.x), float(o.y), float(o.z)]}, quaternion_wxyz = '
            f"{[float(getattr(q, k)) for k in 'wxyz']} }}",
        ]
    )


def test_a_spline_is_fitted_where_the_file_says_so(fitted: SplinePatch) -> None:
    assert min(fitted.cells) > 4


def test_its_tolerance_can_be_chosen(toy: Path, fitted: SplinePatch) -> None:
    finer = surface(load(toy, BEFORE + SPLINE.replace('kind = "spline"', 'kind = "spline"\ntolerance_mm = 0.002')))
    assert finer.coefficients.size > fitted.coefficients.size


def test_the_command_lines_name_outdoes_the_files(toy: Path) -> None:
    for text in (SCENE, BEFORE + SPLINE):
        (toy / "named.toml").write_text(text)
        assert isinstance(surface(load_scene(toy / "named.toml", contact="spline")), SplinePatch)
        contact = load_scene(toy / "named.toml", contact="P4").contact
        assert contact is not None
        assert name_of(contact.surface) == "P4"


def test_by_its_coefficients_it_is_the_same_patch(toy: Path, fitted: SplinePatch) -> None:
    again = surface(load(toy, BEFORE + table(fitted)))
    np.testing.assert_allclose(again.height(U, V), fitted.height(U, V), atol=1e-12)


def test_a_left_knees_is_the_mirror_image(toy: Path, fitted: SplinePatch) -> None:
    left = BEFORE.replace('name = "toy"', 'name = "toy"\nside = "left"\n[axes]\nworld_medial_lateral = "y"')
    assert 'side = "left"' in left
    text = left + table(fitted)
    mirrored = surface(load(toy, text))
    np.testing.assert_allclose(mirrored.height(U, -V), fitted.height(U, V), atol=1e-12)


def test_the_rigs_spline_can_be_had_by_a_file(tmp_path: Path) -> None:
    write_example(tmp_path, 1)
    text = (tmp_path / "scene.toml").read_text()
    text = re.sub("^emphasis = .*$", "", text, flags=re.MULTILINE)
    text = changed('degree = "P5"', f'kind = "spline"\ntolerance_m = {RIG_TOLERANCE}', text)
    text = changed("half_width_mm = 22", f"half_width_m = {RIG_RIM}", text)
    np.testing.assert_allclose(
        surface(load(tmp_path, text)).height(U, V), surface(rig.case(1, "spline")).height(U, V), atol=1e-9
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SPLINE.replace('kind = "spline"', 'kind = "spline"\ndegree = "P5"'), "a spline with a degree"),
        (SURFACE + "\ntolerance_mm = 0.1\n", "a polynomial with tolerance_m"),
        (SPLINE.replace('kind = "spline"', 'kind = "nurbs"'), "kind"),
        ("[contact.surface]\nspline_coefficients_m = [[1, 2, 3, 4], [1, 2, 3]]\n", "4 or more rows of one length"),
        ("[contact.surface]\nspline_coefficients_m = []\n", "4 or more rows of one length"),
    ],
)
def test_mistakes(toy: Path, text: str, message: str) -> None:
    chart = 'half_size_m = [0.02, 0.02]\nchart = { type = "plane" }\n' if "coefficients" in text else ""
    with pytest.raises(InputError, match=message):
        load(toy, BEFORE + text + chart)


def test_a_spline_cannot_be_had_of_a_polynomials_coefficients(toy: Path, fitted: SplinePatch) -> None:
    for text, asked in ((LIGHT, "spline"), (BEFORE + table(fitted), "P5")):
        (toy / "other.toml").write_text(text)
        with pytest.raises(InputError, match=f"{asked} was requested, but this surface is not fitted to a mesh"):
            load_scene(toy / "other.toml", contact=asked)


@pytest.mark.slow
def test_fit_surface_writes_what_a_scene_file_takes(toy: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "femur.stl"
    save_mesh(rig_implant().mesh(deviation=0.03e-3), mesh)
    angles = ("--angles-deg", "-75", "30")
    result = CliRunner().invoke(
        app, ["fit-surface", str(mesh), "--units", "m", "--kind", "spline", "--json", "-", *angles]
    )
    assert result.exit_code == 0, result.output
    (fit,) = json.loads(result.stdout)["fits"]
    assert fit["name"] == "spline"
    assert fit["rms_m"] <= 0.02e-3
    q, o = fit["chart"]["quaternion_wxyz"], fit["chart"]["origin_m"]
    text = "\n".join(
        [
            "[contact.surface]",
            *(f"{name} = {fit[name]}" for name in ("spline_coefficients_m", "center_m", "half_size_m")),
            f'chart = {{ type = "plane", origin_m = {o}, quaternion_wxyz = {q} }}',
        ]
    )
    patch, true = surface(load(toy, BEFORE + text)), rig_implant()
    u, v = U[:3], V[:3]
    point = patch.chart.point(u, v, patch.height(u, v))
    at = true.chart.coordinates(point)
    np.testing.assert_allclose(true.height(at.x, at.y), at.z, atol=0.1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--kind", "nurbs"), "no patch 'nurbs'"),
        (("--kind", "spline", "--degree", "P5"), "a spline has no degree to choose"),
        (("--tolerance", "0.1"), "polynomials have no tolerance to choose"),
    ],
)
def test_fit_surface_refuses(toy: Path, options: tuple[str, ...], message: str) -> None:
    result = CliRunner().invoke(app, ["fit-surface", str(toy / "femur.stl"), "--units", "m", *options])
    assert result.exit_code != 0
    assert message in " ".join(f"{result.output} {result.exception}".split())
