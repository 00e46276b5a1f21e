"""An effect that pftwin does not know, written here and nowhere else, takes part in everything at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import hanging_scene, small_scene, vec
from toy_scene_files import LIGHT, write_toy

import fitting
import pftwin
from pftwin.base.leaves import number
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.scene_file import registry
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.line_elements import ElasticLine
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene, check
from pftwin.studies.audit.audit import audit
from pftwin.studies.audit.explain import explain


class Band(ElasticLine):
    """A rubber band: F = K L0 (exp(a e) - 1) / a with the strain e = (L - L0) / L0, never below 0."""

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))
    hardening: Scalar = eqx.field(metadata=quantity("", positive=True, at_most=50.0))
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    observables: ClassVar[dict[str, Observable]] = {"tension": Observable("N", "tension of the band")}

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Its pull."""
        line = self.line(now)
        strain = jnp.maximum(line.length / self.slack_length - 1, 0.0)
        k, a, rest = self.stiffness, self.hardening, self.slack_length
        tension, zero = k * rest * jnp.expm1(a * strain) / a, jnp.zeros_like(strain)
        slope = jnp.where(strain > 0, k * jnp.exp(a * strain), 0.0)
        energy = k * rest**2 * (jnp.expm1(a * strain) / a - strain) / a
        return Load(stiff=(line.term(tension, tension, slope, zero),), energy=energy), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Its tension."""
        return {"tension": self.load(now, memory)[0].stiff[0].force}


def band(name: str = "quadriceps") -> Band:
    ends = vec(0.02, 0, -0.008), vec(0.22, 0.006, 0.035)
    return Band(number(120.0), number(0.14), number(1.5), *ends, "femur", name=name)


def scene() -> Scene:
    return hanging_scene(21).with_effect(band())


@pytest.fixture(scope="module")
def result() -> pftwin.Result:
    return pftwin.simulate(scene())


def test_it_pulls_by_its_law(result: pftwin.Result) -> None:
    assert not result.flags.any()
    times, (insertion, origin) = result.times, ((0.02, 0.0, -0.008), (0.22, 0.006, 0.035))
    world = result.position + np.stack([_rotated(q, insertion) for q in result.quaternion])
    length = np.linalg.norm(np.asarray(origin) - world, axis=1)
    expected = 120.0 * 0.14 * np.expm1(1.5 * (length / 0.14 - 1)) / 1.5
    np.testing.assert_allclose(result.effects["quadriceps"]["tension"], expected, rtol=1e-9)
    assert times.size == 21


def _rotated(q: np.ndarray, v: tuple[float, float, float]) -> np.ndarray:
    w, u = q[0], q[1:]
    return np.asarray(v) + 2 * np.cross(u, np.cross(u, v) + w * np.asarray(v))


def test_its_declarations_are_its_names_bounds_and_units() -> None:
    names = scene()
    assert float(names.get("K1")) == 120.0
    assert float(names.set("K1", 130.0).get("quadriceps.stiffness")) == 130.0
    assert [p.unit for p in fitting.free_parameters(names, ["K1", "L1", "quadriceps.hardening"]).items] == [
        "N/m",
        "m",
        "",
    ]
    with pytest.raises(pftwin.InputError, match=r"quadriceps.hardening.*found 60.*at most 50"):
        check(names.set("quadriceps.hardening", 60.0))


def test_it_is_read_from_a_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_registered", {})  # registered for this test only
    pftwin.register_effect(Band)
    head, tail = LIGHT.split("[[tendon]]", 1)
    rest = tail.split("[[tendon]]", 1)[1]
    table = """[[band]]
name = "quadriceps"
body = "femur"
stiffness_N_per_m = 120
slack_length_mm = 140
hardening = 1.5
insertion_mm = [20, 0, -8]
origin_m = [0.22, 0.012, 0.035]

"""
    path = write_toy(tmp_path, head + table + "[[tendon]]" + rest)
    read = pftwin.load_scene(path).effect("quadriceps")
    assert isinstance(read, Band)
    assert [float(x) for x in (read.stiffness, read.slack_length, read.hardening)] == pytest.approx([120, 0.14, 1.5])
    assert np.asarray(read.origin.array()) == pytest.approx([0.22, 0.012, 0.035])
    path.write_text(path.read_text().replace("hardening = 1.5", "hardening = 51"))
    with pytest.raises(pftwin.InputError, match=r"hardening.*found 51.*50"):
        pftwin.load_scene(path)


@pytest.mark.slow
def test_it_is_fitted(result: pftwin.Result) -> None:
    measured = Measured(
        result.times, center=result.center, femoral_spring_force=result.effects["quadriceps"]["tension"]
    )
    start = scene().set("K1", 132.0).set("L1", 0.139)
    found = fitting.fit_tendons(start, measured, free=("K1", "L1"), use="all", starts=2)
    assert found.channels == ("position", "quadriceps")
    # The fit takes other steps than the run that it is fitted to: half a percent of stiffness.
    np.testing.assert_allclose(found.values, [120.0, 0.14], rtol=1e-2)


def test_it_is_treated() -> None:
    longer = fitting.treatments.quadriceps_lengthening(scene(), 0.005).get("quadriceps.slack_length")
    assert float(longer) == pytest.approx(0.145)
    ends = vec(-0.02, 0, -0.008), vec(-0.07, 0.004, 0.045)
    below = Band(number(600.0), number(0.07), number(2.0), *ends, "tibia", name="patellar_tendon")
    moved = small_scene().with_effect(below)
    transfer = fitting.treatments.Treatment.of("tibial_tuberosity_transfer", medialisation=0.010)
    assert float(transfer(moved).get("patellar_tendon.origin.y")) == pytest.approx(0.004 - 0.010)


def test_it_is_drawn_and_plotted(result: pftwin.Result) -> None:
    drawn = result.geometry()
    np.testing.assert_allclose(drawn["quadriceps_origin"].values, [[0.22, 0.006, 0.035]])
    measured = Measured(result.times, result.center, femoral_spring_force=result.effects["quadriceps"]["tension"])
    figure = result.plot.compared(measured)
    lines = [line.get_ydata() for ax in figure.axes for line in ax.get_lines()]
    assert any(np.shape(y) == (21,) and np.allclose(y, result.effects["quadriceps"]["tension"]) for y in lines)
    assert result.to_dataset()["quadriceps_tension"].attrs["units"] == "N"


@pytest.mark.slow
def test_it_is_explained_and_audited() -> None:
    knee = small_scene(21).with_effect(band())
    parts = {p.name: p for p in explain(knee, dt=5e-3).parts}
    assert parts["quadriceps"].kind == "Band"
    assert parts["quadriceps"].moved > 0
    row = next(r for r in audit(knee, dt=5e-3, only=["quadriceps"]).rows if r.name == "quadriceps")
    assert row.verdict == "indispensable"  # nothing else holds the patella up
