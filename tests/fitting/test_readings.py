"""What effects report is a channel: single markers, and a gauge written here; weights of frames with them."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
import pytest
from small_scene import hanging_scene, small_scene, vec

import fitting
import pftwin
from fitting.calibration.laboratory import Laboratory
from fitting.calibration.plants import Knee, Plant, PlantMotion
from fitting.fit import likelihood_of
from pftwin.base.errors import InputError
from pftwin.base.leaves import number
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Effect, Instant, Load, Observable
from pftwin.model.effects.marker import Marker
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

STEPS = {"dt": 1 / 2400, "integrator": pftwin.LinearImplicit()}
TRUTH = {"K1": 1.12 * 156.0, "L2": 1.015 * 0.0714}
POINTS = {"m1": (0.021, 0.013, 0.009), "m2": (-0.017, -0.011, 0.012)}
MARKERS = tuple(f"{name}.{axis}" for name in POINTS for axis in "xyz")
GAUGE = "gauge.strain"
COMPUTED = ("position", *MARKERS, GAUGE)  # by one program of all fits


class Gauge(Effect):
    """A gauge across the patellar tendon: what its length is more than a gauge length, as a share."""

    length: Scalar = eqx.field(metadata=quantity("m", positive=True))
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="tibia"))
    observables: ClassVar[dict[str, Observable]] = {"strain": Observable("1", "strain")}

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """None."""
        return Load(), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """The strain."""
        end = now.patella.position + now.patella.arm(self.insertion)
        return {"strain": (end - now.tibia.point(self.origin)).norm() / self.length - 1}


def scene() -> Scene:
    return with_sensors(hanging_scene(21))


def with_sensors(scene: Scene) -> Scene:
    for name, point in POINTS.items():
        scene = scene.with_effect(Marker(vec(*point), name=name))
    tendon: Any = scene.effect("patellar_tendon")
    return scene.with_effect(Gauge(number(0.07), tendon.insertion, tendon.origin, name="gauge"))


def true(knee: Scene) -> Scene:
    for name, value in TRUTH.items():
        knee = knee.set(name, value)
    return knee


@cache
def result() -> pftwin.Result:
    return pftwin.simulate(true(scene()), **STEPS)


@cache
def measured() -> Measured:
    """Markers and gauge without noise; nothing is known of the pose."""
    simulated = result()
    read = {f"{name}.{axis}": simulated.effects[name][axis] for name in POINTS for axis in "xyz"}
    return Measured(
        simulated.times,
        np.full(simulated.center.shape, np.nan),
        readings={**read, GAUGE: simulated.effects["gauge"]["strain"]},
        source="cameras",
    )


@cache
def fitted() -> fitting.Estimate:
    return fitting.fit_tendons(
        scene(), measured(), free=tuple(TRUTH), use=(*MARKERS, GAUGE), starts=2, computed=COMPUTED
    )


@pytest.mark.slow
def test_springs_are_found_by_markers_and_a_gauge_alone() -> None:
    found = fitted()
    assert found.channels == (*MARKERS, GAUGE)
    np.testing.assert_allclose(found.values, list(TRUTH.values()), rtol=1e-3)
    assert not found.doubts
    assert found.readings == {**dict.fromkeys(MARKERS, "m"), GAUGE: "1"}


@pytest.mark.slow
def test_an_objective_of_ones_own_is_what_should_read_nothing() -> None:
    """The strain should be zero to within so much that it decides nothing beside the markers."""
    nothing = {**measured().readings, GAUGE: np.zeros(21)}
    data = Measured(measured().times, measured().center, readings=nothing)
    noise = {**dict.fromkeys(MARKERS, 1e-3), GAUGE: 1.0}
    asked: dict[str, Any] = {"free": tuple(TRUTH), "use": (*MARKERS, GAUGE), "noise": noise, "computed": COMPUTED}
    found = fitting.fit_tendons(scene(), data, starts=2, **asked)
    np.testing.assert_allclose(found.values, list(TRUTH.values()), rtol=1e-3)
    strain = np.asarray(result().effects["gauge"]["strain"])
    assert found.objective_value == pytest.approx(0.5 * np.sum(strain**2), rel=0.05)
    assert not found.doubts


def test_a_force_is_not_measured_twice() -> None:
    force = np.linspace(20.0, 30.0, 21)
    data = Measured(result().times, result().center, contact_force=force, readings={"contact.force": force})
    with pytest.raises(InputError, match=r"contact.force and the force of contact"):
        fitting.fit_tendons(with_sensors(small_scene(21)), data, use="all")


@pytest.mark.slow
def test_weights_and_covariances_reach_the_fit_and_its_file(tmp_path: Any) -> None:
    """Both end where the fit of the same problem, written out by hand, ends: at the least of the weighted squares."""
    random = np.random.default_rng(4)
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.3], [0.0, 0.3, 2.0]]) * 1e-8
    center = result().center + random.multivariate_normal(np.zeros(3), covariance, 21)
    data = Measured(result().times, center, weights=np.where(np.arange(21) < 10, 1.0, 3.0))
    asked: dict[str, Any] = {"free": ("K1",), "noise": {"position": covariance}, "computed": COMPUTED, "starts": 1}
    found = fitting.fit_tendons(scene(), data, **asked)
    problem = likelihood_of(fitting.Estimate.load(found.save(tmp_path / "e.json"), scene()), data)
    assert problem.evaluator.fine == found.substeps >= 6
    off = problem.evaluator.values(found.values[None], found.substeps).values[0, :, :3] - center
    weights = data.weights / np.mean(data.weights)  # type: ignore[operator]
    expected = 0.5 * np.sum(weights * np.einsum("ti,ij,tj->t", off, np.linalg.inv(covariance), off))
    assert problem.objective.value(problem.evaluator.values(found.values[None], found.substeps))[0] == pytest.approx(
        expected, rel=1e-9
    )
    assert found.objective_value == pytest.approx(expected, rel=1e-6)
    for refusing in (fitting.train_posterior, fitting.QuickFit.of):
        with pytest.raises(InputError, match="frames have weights"):
            refusing(scene(), data)


def test_a_channel_of_which_no_frame_counts_is_refused() -> None:
    read = np.full(21, np.nan)
    read[3] = 0.02
    data = Measured(
        result().times, result().center, readings={"m1.x": read}, weights=(np.arange(21) != 3).astype(float)
    )
    with pytest.raises(InputError, match=r"no frame in which m1.x was measured counts"):
        fitting.fit_tendons(scene(), data, use=("position", "m1.x"))


@pytest.mark.slow
def test_the_estimate_keeps_its_channels_units_in_its_file(tmp_path: Any) -> None:
    loaded = fitting.Estimate.load(fitted().save(tmp_path / "e.json"), scene())
    assert loaded.readings == fitted().readings
    problem = likelihood_of(loaded, measured())
    assert problem.objective.channels == fitted().channels
    assert problem.objective.noise == pytest.approx(fitted().noise)


@pytest.mark.slow
def test_a_frame_without_weight_is_as_if_it_had_not_been_measured(monkeypatch: Any) -> None:
    """The last that a fit does, a run for the verdict, is left out: it would take a program of its own."""
    monkeypatch.setattr("fitting.fit.compiled_aside", lambda knee, before: lambda: None)
    monkeypatch.setattr("fitting.fit.judge", lambda estimate: None)
    spoilt, weights = np.array(measured().readings["m1.x"]), np.ones(21)
    spoilt[8:11] += 0.02
    weights[8:11] = 0.0
    data = Measured(
        measured().times, measured().center, readings={**measured().readings, "m1.x": spoilt}, weights=weights
    )
    found = fitting.fit_tendons(scene(), data, free=tuple(TRUTH), use=(*MARKERS, GAUGE), starts=2, computed=COMPUTED)
    np.testing.assert_allclose(found.values, list(TRUTH.values()), rtol=1e-3)


@pytest.mark.slow
def test_a_plan_counts_what_markers_tell() -> None:
    """The bound of one parameter by one coordinate, from finite differences of simulations."""
    noise = {"m1.x": 3e-4, "position": 2e-4}
    plan = fitting.plan_experiment(scene(), free=("K1",), use=("m1.x",), candidates=("position",), noise=noise)
    step = 0.02 * 156.0
    ends = [pftwin.simulate(scene().set("K1", 156.0 + by), **STEPS).effects["m1"]["x"] for by in (step, -step)]
    slope = (ends[0] - ends[1]) / (2 * step)
    assert plan.covariance[0, 0] == pytest.approx((3e-4) ** 2 / np.sum(slope**2), rel=2e-2)
    assert plan.additions["position"][0] < plan.relative[0]


def test_a_plan_asks_for_the_noise_of_a_reading() -> None:
    with pytest.raises(InputError, match=r"no noise of 'm2.y'.*\[m\]"):
        fitting.plan_experiment(scene(), free=("K1",), use=("m2.y",))


@pytest.mark.parametrize(
    ("use", "said"),
    [(("m3.x",), "no channel 'm3.x'.*one of: m1.x"), (("contact.force_medial",), "no channel 'contact.force_medial'")],
)
def test_what_was_not_measured_is_refused(use: Any, said: str) -> None:
    with pytest.raises(InputError, match=f"(?s){said}"):
        fitting.fit_tendons(with_sensors(small_scene(21)), measured(), use=use)


def test_a_reading_of_nothing_is_refused() -> None:
    simulated = result()
    data = Measured(simulated.times, simulated.center, readings={"gauge.stress": np.zeros(21)})
    with pytest.raises(InputError, match=r"(?s)no observable 'gauge.stress'.*one of: gauge.strain"):
        fitting.fit_tendons(scene(), data)


def test_a_laboratory_records_readings_with_their_noise() -> None:
    knee, simulated = scene(), result()
    reported = {name: {key: np.asarray(v) for key, v in each.items()} for name, each in simulated.effects.items()}
    motion = PlantMotion(np.asarray(simulated.position), np.asarray(simulated.quaternion), reported)
    lab = Laboratory(readings={"m1.x": 5e-4, GAUGE: 1e-3}, cutoff=None)
    random = np.random.default_rng(3)
    both = [lab.recorded(knee, motion, {"femoral": "quadriceps"}, random)[1] for _ in range(12)]
    for name, deviation in lab.readings.items():
        owner, _, key = name.rpartition(".")
        off = np.stack([data.readings[name] for data in both]) - motion.reported[owner][key]
        assert off.std() == pytest.approx(deviation, rel=0.15)


def test_calibrations_refuse_readings_that_nobody_records() -> None:
    trained = fitting.QuickFit.of(scene(), measured(), free=("K1",), use=("m1.x",), noise={"m1.x": 1e-3})
    with pytest.raises(InputError, match=r"m1.x is not recorded.*Laboratory"):
        fitting.calibrate(trained, scene(), plants=1, kinds={"same": lambda knee, random: Plant(_of(knee))})


def _of(knee: Knee) -> Scene:
    return knee.scene


def test_swapped_coordinates_are_noticed() -> None:
    read = dict(measured().readings)
    read["m1.x"], read["m1.y"] = read["m1.y"], read["m1.x"]
    data = Measured(measured().times, measured().center, readings=read)
    with pytest.raises(InputError, match=r"measured m1.x and m1.y look swapped"):
        fitting.fit_tendons(scene(), data, free=tuple(TRUTH), use=MARKERS, starts=2, computed=COMPUTED)
