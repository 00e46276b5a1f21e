"""Calibration of several trials of one plant, and of searches, on the two trials of a small knee."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from lifted_trials import BOUNDS, FREE, MOVED, POINT, alike, nominal
from small_scene import small_scene

import fitting
from fitting.calibration import quick_fit
from fitting.calibration.calibrate import calibrate, plant_in_trials, with_differences
from fitting.calibration.laboratory import Laboratory
from fitting.calibration.plants import PLANTS, Knee, Plant, PlantMotion, truth_of
from fitting.calibration.quick_fit import QuickFit
from fitting.nuisance import Nuisance
from fitting.set_up import SetUp
from fitting.trials import free_in_trials
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

NUISANCE = Nuisance(attachments=1e-3, friction=0.02)
QUIET = Laboratory(marker_noise=1e-8, cutoff=None, force_noise=1e-8, force_bias=0.0)


def knees() -> list[Knee]:
    scenes, own = free_in_trials(alike(), FREE, BOUNDS, None, NUISANCE)
    return [Knee(scene, parameters, tuple(scenes)) for scene, parameters in zip(scenes, own, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(PLANTS))
def test_a_plant_is_the_same_in_every_trial(kind):
    """But for its insertion, elsewhere by as much as that of the nominal knee; the first is as of one trial."""
    one, other = (plant.scene for plant in plant_in_trials(PLANTS[kind], knees(), np.random.default_rng(4)))
    alone = PLANTS[kind](knees()[0], np.random.default_rng(4)).scene
    assert float(other.get(POINT)) - float(one.get(POINT)) == pytest.approx(MOVED)
    for name in ("K1", "L2", "quadriceps.origin.x", "contact.friction.coefficient", "quadriceps.damping"):
        assert float(one.get(name)) == pytest.approx(float(other.get(name)), abs=1e-12)
        assert float(one.get(name)) == float(alone.get(name))
    assert float(one.get("K1")) != float(alike()[0].get("K1"))


def test_two_plants_are_two():
    random = np.random.default_rng(4)
    first, second = (plant_in_trials(PLANTS["misplaced"], knees(), random)[1].scene for _ in range(2))
    assert float(first.get("K1")) != float(second.get("K1"))


@pytest.mark.slow
def test_the_line_is_nearest_over_all_trials():
    plant = PLANTS["stiffening"](knees()[0], np.random.default_rng(4))
    tendon = plant.scene.effect("quadriceps")
    parts = [
        float(tendon.rest_length) + stretch for stretch in (np.linspace(0.01, 0.02, 40), np.linspace(0.03, 0.06, 70))
    ]
    motions = [
        PlantMotion(
            np.zeros((len(p), 3)),
            np.zeros((len(p), 4)),
            {name: {"length": p} for name in ("quadriceps", "patellar_tendon")},
        )
        for p in parts
    ]
    own = free_in_trials([alike()[0]], ("K1",), 0.3, None, Nuisance())[1][0]
    k, more, s = float(tendon.law.stiffness), float(tendon.law.more), np.concatenate(parts) - float(tendon.rest_length)
    assert truth_of(plant, motions, own)[0] == pytest.approx(np.polyfit(s, k * s * (1 + more * s), 1)[0])
    assert truth_of(plant, motions[:1], own)[0] != pytest.approx(truth_of(plant, motions, own)[0], rel=1e-3)


def test_differences_are_each_trials_own():
    """Normal, of the deviation that is stated; nothing else differs, and the plant itself stays."""
    items = free_in_trials(alike(), FREE, BOUNDS, None, NUISANCE, {"L2": 2e-4})[1][0].items
    plant = plant_in_trials(PLANTS["misplaced"], knees(), np.random.default_rng(4))
    mean, random = float(plant[0].scene.get("L2")), np.random.default_rng(5)
    drawn = [with_differences(plant, items, random) for _ in range(300)]
    off = np.array([[float(one.scene.get("L2")) - mean for one in each] for each in drawn])
    np.testing.assert_allclose(off.std(axis=0), 2e-4, rtol=0.15)
    assert np.abs(off.mean(axis=0)).max() < 4e-5
    assert abs(np.corrcoef(off.T)[0, 1]) < 0.2
    for name in ("K1", "L1", "quadriceps.origin.x"):
        assert {float(each[1].scene.get(name)) for each in drawn} == {float(plant[1].scene.get(name))}
    assert float(plant[1].scene.get("L2")) == mean
    assert len(with_differences(plant[:1], items, random)) == 1


def test_the_line_is_that_of_the_mean_length():
    """A trial whose tendon is 0.4 mm longer, at lengths that are too, pulls nearly as the mean's does, by the same
    line."""
    plant = PLANTS["stiffening"](knees()[0], np.random.default_rng(4))
    own = free_in_trials([alike()[0]], ("K2", "L2"), 0.3, None, Nuisance())[1][0]
    tendon: Any = plant.scene.effect("patellar_tendon")
    lengths = float(tendon.rest_length) + np.linspace(0.003, 0.011, 50)

    def motion(by: float) -> PlantMotion:
        return PlantMotion(np.zeros((50, 3)), np.zeros((50, 4)), {"patellar_tendon": {"length": lengths + by}})

    longer = Plant(plant.scene.with_effect(tendon.lengthened(4e-4)), plant.curved)
    expected = truth_of(plant, [motion(0.0), motion(0.0)], own)
    found = truth_of(plant, [motion(0.0), motion(4e-4)], own, [plant, longer])
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    off = truth_of(plant, [motion(0.0), motion(4e-4)], own)  # as if it were the same tendon, stretched by more
    assert abs(off[0] / expected[0] - 1) > 4e-4


def test_the_line_is_that_of_the_mean_stiffness():
    """Trials whose tendon is stiffer or softer, at the same lengths: the mean over all possible trials is reported."""
    plant = PLANTS["stiffening"](knees()[0], np.random.default_rng(4))
    own = free_in_trials([alike()[0]], ("K2", "L2"), 0.3, None, Nuisance())[1][0]
    tendon: Any = plant.scene.effect("patellar_tendon")
    lengths = float(tendon.rest_length) + np.linspace(0.003, 0.011, 50)
    motion = PlantMotion(np.zeros((50, 3)), np.zeros((50, 4)), {"patellar_tendon": {"length": lengths}})
    stiffer = [Plant(plant.scene.set("K2", by * float(tendon.stiffness)), plant.curved) for by in (1.1, 1.2)]
    found = truth_of(plant, [motion, motion], own, stiffer)
    np.testing.assert_allclose(found, truth_of(plant, [motion], own), rtol=1e-9)


def test_trials_of_one_laboratory_share_what_stays_the_same():
    """Placement and scale are those of the first; shift and zero are each trial's own."""
    scene, n = small_scene(41), 41
    ramp = np.linspace(5.0, 25.0, n)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    motion = PlantMotion(np.zeros((n, 3)), upright, {"contact": {"force": ramp}, "quadriceps": {"tension": ramp}})

    def off(**errors: float) -> list[Measured]:
        lab = replace(QUIET, marker_noise=0.0, force_noise=0.0, **errors)
        return [
            lab.recorded(scene, motion, {}, random, np.random.default_rng(8), first=k == 0)[1]
            for k, random in enumerate([np.random.default_rng(1), np.random.default_rng(2)])
        ]

    one, other = off(placement=2e-3)
    np.testing.assert_array_equal(one.center, other.center)
    assert np.abs(one.center - off()[0].center).max() > 1e-4
    one, other = off(force_scale=0.05)
    np.testing.assert_array_equal(one.contact_force, other.contact_force)
    assert np.abs(one.contact_force / ramp - 1).min() > 1e-3
    for errors in ({"time_shift": 0.02}, {"force_bias": 0.5}):
        one, other = off(**errors)
        assert np.abs(one.contact_force - other.contact_force).max() > 1e-3


def measured_in(scenes: Any) -> list[Measured]:
    return [Measured(s.motion.times, np.zeros((s.motion.times.size, 3))) for s in scenes]


def test_what_cannot_be_calibrated_is_refused():
    both = QuickFit.of(alike(), measured_in(alike()), free=FREE, bounds=BOUNDS)
    assert both.sentence() == "fits by least_squares of 41, 41 frames of low + high, by position"
    with pytest.raises(InputError, match="41 frames; expected: 41, 41, as it was set up for"):
        calibrate(both, alike()[0])
    with pytest.raises(InputError, match="learned from anew for each plant"):
        QuickFit.of(alike(), measured_in(alike()), method="simulations")
    with pytest.raises(InputError, match="method: 'best'; expected: one of: least_squares"):
        QuickFit.of(alike(), measured_in(alike()), method="best")
    with pytest.raises(InputError, match="cannot allow for placement"):
        QuickFit.of(alike(), measured_in(alike()), nuisance=Nuisance(placement=1e-3))
    assert isinstance(both.set_up, SetUp)


def test_a_search_uses_what_was_measured_in_each_trial_of_the_first_recording(monkeypatch):
    """The force in the second trial alone; plants have it in both."""
    ramp = np.linspace(5.0, 25.0, 41)
    first = [measured_in(alike())[0], replace(measured_in(alike())[1], femoral_spring_force=ramp)]
    fit = QuickFit.of(alike(), first, free=FREE, bounds=BOUNDS, use=("position", "quadriceps"))
    assert fit.measured == (("position",), ("position", "quadriceps"))
    everything = [replace(m, femoral_spring_force=ramp, tibial_spring_force=ramp, contact_force=ramp) for m in first]
    passed = {}
    monkeypatch.setattr(
        quick_fit, "fit_tendons", lambda scene, measured, **asked: passed.update(data=measured, **asked)
    )
    fit.estimate(alike(), everything)
    assert [m.femoral_spring_force is None for m in passed["data"]] == [True, False]
    assert all(m.contact_force is None and m.tibial_spring_force is None for m in passed["data"])
    assert passed["use"] == ("position", "quadriceps")


def test_plants_of_an_exact_twin_are_misplaced_too():
    """By up to 1 mm times sqrt(3) times 0.6; the twin itself is not."""
    made = []

    def kind(knee: Knee, random: np.random.Generator) -> Plant:
        made.append([PLANTS[name](knee, random).scene for name in ("twin", "misplaced")])
        raise InputError("enough")

    with pytest.raises(InputError, match="enough"):
        calibrate(QuickFit.of(alike(), measured_in(alike()), free=FREE, bounds=BOUNDS), alike(), kinds={"mine": kind})
    by = [abs(float(s.get("quadriceps.origin.x")) - float(alike()[1].get("quadriceps.origin.x"))) for s in made[0]]
    assert by[0] == 0
    assert 1e-5 < by[1] < 1e-3 * np.sqrt(3) * 0.6


@pytest.mark.slow
def test_a_mean_of_trials_that_differ_is_found_as_well_as_it_can_be():
    """By two trials, to the deviation between trials over the root of two; no interval is narrower."""
    given: Any = {"free": ("K1", "L2"), "bounds": 0.2, "varies": {"L2": 1e-3}}
    fit = fitting.QuickFit.of(nominal(), measured_in(nominal()), **given)
    loud = Laboratory(marker_noise=4e-4, cutoff=None)
    found = calibrate(fit, nominal(), plants=12, kinds={"twin": PLANTS["twin"]}, laboratory=loud, seed=2)
    answers = found.kinds["twin"]
    assert (len(answers.errors), answers.doubted, answers.refused, answers.dropped) == (12, 0, 0, 0)
    size = 1e-3 / np.sqrt(2) / 0.0714
    assert answers.half_widths[:, 1].mean() == pytest.approx(1.96 * size, rel=0.05)
    assert 0.5 * size < np.sqrt(np.mean(answers.errors[:, 1] ** 2)) < 1.6 * size


@pytest.mark.slow
def test_searches_find_plants_of_two_trials():
    """Where nothing is off but noise: as near to the truth as they say."""
    fit = fitting.QuickFit.of(nominal(), measured_in(nominal()), free=("K1", "L2"), bounds=0.2)
    loud = Laboratory(marker_noise=5e-4, cutoff=None)
    found = calibrate(fit, nominal(), plants=4, kinds={"twin": PLANTS["twin"]}, laboratory=loud, seed=2)
    answers = found.kinds["twin"]
    assert (found.names, found.trained) == (("K1", "L2"), fit.sentence())
    assert (len(answers.errors), answers.doubted, answers.refused, answers.dropped) == (4, 0, 0, 0)
    assert (np.abs(answers.errors) < 1.7 * answers.half_widths).all()  # 3.3 deviations
    assert (answers.half_widths < [0.05, 0.01]).all()
