"""The example of a new effect, as the page prints it, runs and is right."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import pftwin
from pftwin.base.spatial import Quaternion, Vec3
from pftwin.model.effects.base import Ground, Instant, Patella
from pftwin.model.motion import Frame

PAGE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "page"}
    exec(compile(blocks()[0], str(PAGE), "exec", dont_inherit=True), names)
    return names


def at(y: Any, speed: float = 0.0) -> Instant:
    place = Vec3(jnp.asarray(0.01), jnp.asarray(y), jnp.asarray(0.05))
    patella = Patella.at_rest(place, Quaternion.identity())
    patella = eqx.tree_at(lambda p: p.velocity.y, patella, jnp.asarray(speed))
    return Instant(patella, Ground(), Frame.world(), jnp.asarray(0.0), jnp.asarray(0.0))


def test_it_is_as_short_as_it_says() -> None:
    body = blocks()[0].split("class Brace")[1]
    assert len([line for line in body.splitlines() if line.strip()]) <= 21


@pytest.mark.parametrize("y", [-0.01, 0.004, 0.006, 0.02])
def test_force_is_minus_the_gradient_of_the_energy(page: dict[str, Any], y: float) -> None:
    brace = page["Brace"](jnp.asarray(2000.0), jnp.asarray(0.005))
    load, _ = brace.load(at(y), None)
    expected = -jax.grad(lambda y: brace.load(at(y), None)[0].energy)(jnp.asarray(y))
    np.testing.assert_allclose(load.total().force.y, expected, atol=1e-12)
    np.testing.assert_allclose(expected, -2000.0 * max(y - 0.005, 0.0), rtol=1e-12)


def test_slope_and_rate_of_its_stiff_term(page: dict[str, Any]) -> None:
    brace = page["Brace"](jnp.asarray(2000.0), jnp.asarray(0.005))
    (term,) = brace.load(at(0.02, speed=0.3), None)[0].stiff
    assert float(term.rate) == pytest.approx(0.3)
    assert float(term.stiffness) == 2000.0
    assert float(brace.load(at(0.02, speed=0.3), None)[0].dissipation()) == 0.0


@pytest.mark.slow
def test_the_whole_example_runs(page: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    scene = small_scene(11)
    monkeypatch.setattr(pftwin.rig, "case", lambda n: scene)
    monkeypatch.setattr(pftwin, "configure", lambda: None)  # the tests have settings of their own
    text = blocks()[1].replace("0.005", "-0.005")  # the small knee shifts less: pressed from the start
    exec(compile(text, str(PAGE), "exec", dont_inherit=True), page)
    assert "frames" in capsys.readouterr().out
    pushes = np.asarray(page["result"].to_dataset()["brace_push"])
    assert pushes.shape == (11,)
    assert (pushes > 0.5).all()
