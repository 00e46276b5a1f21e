"""`pftwin doctor`: sound here, broken where something is broken, and never a traceback."""

from __future__ import annotations

import dataclasses
import json
from importlib import metadata

import numpy as np
import pytest
from typer.testing import CliRunner

from pftwin.cli import app
from pftwin.cli import doctor as command
from pftwin.cli.exit_codes import ExitCode


def doctor(*arguments: str):
    return CliRunner().invoke(app, ["doctor", *arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture(scope="module")
def rested():
    """The self-test's own run."""
    from pftwin import rig
    from pftwin.dynamics.simulate import simulate

    scene = rig.case(1)
    return simulate(dataclasses.replace(scene, motion=dataclasses.replace(scene.motion, n_frames=command.FRAMES)))


@pytest.mark.slow
def test_this_installation_is_sound(rested):
    done = doctor("--json", "-")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["sound"]
    found = {f["name"]: f for f in facts["findings"]}
    assert found["numpy"]["found"] == np.__version__
    assert found["precision"]["found"] == "float64"
    assert "residual force" in found["equilibrium at the start"]["found"]
    assert {"c3d", "cuda", "viewer", "posterior"} <= set(facts["extras"])
    assert "sound" in done.stderr


@pytest.mark.parametrize(
    ("broken", "finding"),
    [
        ({"residual": 2e-6}, "equilibrium at the start"),
        ({"work": 0.3}, "energy budget"),
        ({"position": float("nan")}, "simulation"),
        ({"dtype": "float32"}, "precision of the run"),
    ],
)
def test_the_self_test_sees_wrong_mechanics(rested, monkeypatch, broken, finding):
    """A run in which one thing is wrong: forces that do not balance, energy from nowhere, NaN, single precision."""
    changed = rested
    if "residual" in broken:
        changed = dataclasses.replace(rested, equilibrium=dataclasses.replace(rested.equilibrium, **broken))
    elif "work" in broken:
        changed = dataclasses.replace(
            rested, energies=dataclasses.replace(rested.energies, work=broken["work"] * rested.energies.work)
        )
    elif "position" in broken:
        changed = dataclasses.replace(rested, position=rested.position * np.nan)
    else:
        changed = dataclasses.replace(rested, **broken)
    monkeypatch.setattr("pftwin.dynamics.simulate.simulate", lambda scene: changed)
    assert [f.name for f in command.self_test() if not f.sound] == [finding]


def test_a_simulation_that_fails_is_a_finding(monkeypatch):
    def fails(scene):
        raise RuntimeError("no kernel")

    monkeypatch.setattr("pftwin.dynamics.simulate.simulate", fails)
    done = doctor()
    assert done.exit_code == ExitCode.FLAGGED
    assert "RuntimeError: no kernel" in done.output
    assert "Traceback" not in done.output


def test_a_missing_package_is_named_and_nothing_is_simulated(monkeypatch):
    real = metadata.version

    def version(name):
        if name == "optax":
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setattr("pftwin.dynamics.simulate.simulate", lambda scene: pytest.fail("simulated"))
    done = doctor()
    assert done.exit_code == ExitCode.FLAGGED
    assert "optax: not installed" in done.stderr
    assert "pip install 'optax>=" in done.output


def test_too_old_a_package_is_broken(monkeypatch):
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.1" if name == "jax" else real(name))
    assert [f.name for f in command.packages() if not f.sound] == ["jax"]


def test_an_extra_that_is_not_there_says_how_to_get_it(monkeypatch):
    real = metadata.version

    def version(name):
        if name == "ezc3d":
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(metadata, "version", version)
    extra = next(e for e in command.extras() if e.name == "c3d")
    assert not extra.present
    assert extra.remedy == "python -m pip install 'pftwin[c3d]'"


def test_an_extra_of_another_package_is_not_there_without_its_parts(monkeypatch):
    """`cuda` is jax with CUDA: jax alone is not enough."""
    real = metadata.version

    def version(name):
        if "cuda" in name:
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(metadata, "version", version)
    assert not next(e for e in command.extras() if e.name == "cuda").present


def test_a_cache_that_cannot_be_written_to_is_broken(tmp_path):
    (tmp_path / "file").write_text("")
    assert not command.cache(tmp_path / "file" / "compiled").sound
    found = command.cache(tmp_path)
    assert found.sound
    assert "1 files" in found.found
