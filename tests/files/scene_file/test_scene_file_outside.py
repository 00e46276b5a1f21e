"""Files that a scene file names lie in its folder, or somebody has said that they need not."""

from __future__ import annotations

import pytest
from toy_scene_files import LIGHT, SCENE
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli.program import app
from pftwin.files.scene_file import load_scene

MARKERS = LIGHT.replace('poses = "poses.csv"', 'markers = "walk.trc"').replace(
    'body = "tibia"', 'three_points = { markers = ["T1", "T2", "T3"] }', 1
)
WORDS = r"leads out of the scene's folder; expected: a file beside the scene file.*--allow-outside.*allow_outside=True"


@pytest.fixture
def scene(toy, tmp_path):
    """A scene file in a folder of its own, beside one with a copy of all files, and how to write it."""
    secret, folder = tmp_path / "elsewhere", tmp_path / "scene"
    secret.mkdir()
    folder.mkdir()
    for name in ("poses.csv", "femur.stl", "walk.trc"):
        (secret / name).write_bytes((toy / name).read_bytes())

    def write(text: str):
        (folder / "scene.toml").write_text(text)
        return folder / "scene.toml"

    return write


@pytest.mark.parametrize("way", ["parent", "absolute", "link", "link to a folder", "out and in again"])
def test_a_path_that_leads_out_is_refused_and_allowed(scene, tmp_path, way):
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "scene"
    name = {
        "parent": "../elsewhere/poses.csv",
        "absolute": str(elsewhere / "poses.csv"),
        "link": "mine.csv",
        "link to a folder": "mine/poses.csv",
        "out and in again": "sub/../../elsewhere/poses.csv",
    }[way]
    (folder / "sub").mkdir()
    (folder / "mine.csv").symlink_to(elsewhere / "poses.csv")
    (folder / "mine").symlink_to(elsewhere)
    file = scene(LIGHT.replace('"poses.csv"', f'"{name}"'))
    with pytest.raises(InputError, match=rf"scene.toml, line \d+, \[motion\] poses: .*{WORDS}"):
        load_scene(file)
    assert load_scene(file, allow_outside=True).motion.n_frames == 41


@pytest.mark.parametrize("name", ["poses.csv", "./poses.csv", "data/poses.csv", "data/../poses.csv"])
def test_what_lies_inside_is_read_wherever_the_folder_is(scene, tmp_path, monkeypatch, name):
    folder = tmp_path / "scene"
    (folder / "data").mkdir()
    for place in (folder, folder / "data"):
        (place / "poses.csv").write_bytes((tmp_path / "elsewhere" / "poses.csv").read_bytes())
    scene(LIGHT.replace('"poses.csv"', f'"{name}"'))
    (tmp_path / "linked").symlink_to(folder)
    monkeypatch.chdir(folder)
    for file in ("scene.toml", folder / "scene.toml", tmp_path / "linked" / "scene.toml"):
        assert load_scene(file).motion.n_frames == 41


@pytest.mark.parametrize(
    ("text", "name", "where"),
    [
        (SCENE, "femur.stl", r"\[contact\] surface.mesh"),
        (MARKERS, "walk.trc", r"\[motion\] markers"),
        (
            LIGHT + '[measured]\npatella = { body = "patella" }\nforces = "forces.csv"\ncontact_force = "total_N"\n',
            "forces.csv",
            r"\[measured\] forces",
        ),
        (
            LIGHT + '[[prescribed_tension]]\nfile = "pulls.csv"\nbody = "femur"\n',
            "pulls.csv",
            r"\[\[prescribed_tension\]\].* file",
        ),
        (LIGHT + '[[strands]]\nfile = "strands.json"\nbody = "femur"\n', "strands.json", r"\[\[strands\]\].* file"),
    ],
    ids=["mesh", "markers", "forces", "tensions", "strands"],
)
def test_every_field_that_names_a_file_is_watched(scene, tmp_path, text, name, where):
    (tmp_path / "scene" / "poses.csv").write_bytes((tmp_path / "elsewhere" / "poses.csv").read_bytes())
    assert text.count(f'"{name}"') == 1
    with pytest.raises(InputError, match=rf"{where}: .*{WORDS}"):
        load_scene(scene(text.replace(f'"{name}"', f'"../elsewhere/{name}"')))


def test_files_outside_the_folder_are_not_opened(scene, tmp_path):
    """A scene's name, say, that is the name of a file: its content is no part of what is kept."""
    from pftwin.files.scene_file.document import Document

    file = scene(f'name = "{tmp_path / "elsewhere" / "poses.csv"}"\n')
    assert Document.read(file).files() == (file,)
    assert Document.read(file, allow_outside=True).files() == (file, tmp_path / "elsewhere" / "poses.csv")


def test_the_command_line_says_so_and_has_a_switch(scene, tmp_path):
    file = scene(LIGHT.replace('"poses.csv"', '"../elsewhere/none.csv"'))
    command = ["simulate", str(file), "-o", str(tmp_path / "out.nc")]
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code == 2
    assert "leads out of the scene's folder" in refused.output
    allowed = CliRunner().invoke(app, ["--allow-outside", *command])
    assert allowed.exit_code == 2
    assert "none.csv: no such file" in allowed.output
