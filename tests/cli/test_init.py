"""`pftwin init`: an example of a scene."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import numpy as np
from commands import pftwin, refused

from pftwin import rig
from pftwin.files.scene_file import load_scene, load_scene_file

EXAMPLE = ("case1_forces.csv", "case1_markers.trc", "femoral_component.stl")  # files that `init` writes


def test_init_writes_an_example_that_simulates(tmp_path: Path) -> None:
    result = pftwin("init", tmp_path / "new" / "knee")
    assert result.exit_code == 0, result.output
    folder = tmp_path / "new" / "knee"
    assert sorted(p.name for p in folder.iterdir()) == [*EXAMPLE, "scene.toml"]
    assert f"next: pftwin simulate {folder / 'scene.toml'}" in result.stdout
    result = pftwin("validate", folder / "scene.toml", "--json", "-", "--dt", "0.002")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["synthetic"] is True


def test_init_overwrites_nothing(tmp_path: Path) -> None:
    mine = EXAMPLE[1]
    (tmp_path / mine).write_text("mine")
    assert f"{mine}: is there already" in refused("init", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [mine]
    assert (tmp_path / mine).read_text() == "mine"


def test_init_of_the_rig_is_the_rigs_own_case(tmp_path: Path) -> None:
    result = pftwin("init", tmp_path, "--case", 1)
    assert result.exit_code == 0, result.output
    ours, theirs = load_scene(tmp_path / "scene.toml"), rig.case(1)
    assert [e.name for e in ours.effects] == [e.name for e in theirs.effects]
    at, true = (s.motion.tibia.frames(1.23).origin.array() for s in (ours, theirs))
    np.testing.assert_allclose(at, true, atol=1e-5)
    for one, other in ((ours.effects, theirs.effects), (ours.patella, theirs.patella), (ours.start, theirs.start)):
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-5)  # the mesh's file is in single precision
    measured = load_scene_file(tmp_path / "scene.toml").measured
    assert measured is not None
    np.testing.assert_allclose(measured.center, rig.measured(1).center, atol=1e-9)
    np.testing.assert_allclose(measured.contact_force, rig.measured(1).contact_force, atol=1e-9)
