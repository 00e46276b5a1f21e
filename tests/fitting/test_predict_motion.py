"""A fitted knee's motion with bands, beside what was measured of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_estimates import made_estimate
from small_scene import small_scene

from fitting.prediction.motion import predict_motion
from fitting.prediction.predicted_motion import COORDINATES
from pftwin import equilibrium, simulate
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import check

LEFT = {"X": 0.4e-3, "Y": 0.9e-3, "Z": 1.7e-3, "tilt": 0.02, "flexion": 0.03, "rotation": 0.05}
PLACE = "quadriceps.origin.y"
VALUES = {"K1": (160.0, 4.0), "L2": (0.0715, 2e-4), PLACE: (0.014, 1e-6)}
NOMINAL = np.array([154.0, 0.066, 0.014])


def fitted(**more):
    """Of two springs and a coordinate, in all tests: one program."""
    left = {**LEFT, "position": 1e-3, "orientation": 0.03}
    return made_estimate(VALUES, **{"rmse": left, "nominal": NOMINAL, "coordinates": (PLACE,), **more})


@pytest.fixture(scope="module")
def knee():
    return small_scene()


@pytest.fixture(scope="module")
def truth(knee):
    """What a knee with other springs does, as simulated."""
    own = knee.set("K1", 158.0).set("L2", 0.07165)
    found = simulate(own, dt=2e-3)
    return Measured(found.times, found.center, np.asarray(found.quaternion), source="another simulation")


@pytest.fixture(scope="module")
def predicted(knee, truth):
    return predict_motion(knee, fitted(), truth, samples=24, seed=3, dt=2e-3)


def test_the_path_is_that_of_the_estimate(knee, predicted):
    own = simulate(fitted().apply(knee), dt=2e-3)
    np.testing.assert_allclose(predicted.value[:, :3], 1e3 * own.center, atol=1e-6)
    for k, name in enumerate(COORDINATES):
        if k >= 3:
            np.testing.assert_allclose(predicted.value[:, k], np.degrees(getattr(own.angles, name)), atol=1e-6)


def test_bands_hold_draws_and_what_the_fit_left(predicted):
    """Where springs hardly matter, a band is 1.645 of the deviations that were left to either side."""
    left = np.array([0.4, 0.9, 1.7, *np.degrees([LEFT["flexion"], LEFT["rotation"], LEFT["tilt"]])])
    half = 0.5 * (predicted.high - predicted.low)
    assert (half > 0.95 * 1.645 * left).all()
    assert (half.min(axis=0) / (1.645 * left)).min() < 1.1


def test_residuals_are_corrected_for_the_number_of_fitted_parameters(knee, predicted):
    """Three parameters take from 12 values a quarter of the squares of the errors: SD = rms sqrt(12 / 9)."""
    few = predict_motion(knee, fitted(values_compared=12), samples=24, seed=3, dt=2e-3)
    half = [0.5 * (found.high - found.low).min(axis=0) for found in (predicted, few)]
    where_springs_hardly_matter = [k for k, name in enumerate(COORDINATES) if name != "x"]
    assert (half[1] / half[0])[where_springs_hardly_matter] == pytest.approx(np.sqrt(12 / 9), rel=2e-3)
    assert "x 0.46 mm, y 1 mm, z 2 mm" in few.notes[0]  # 0.4, 0.9 and 1.7 mm, rms
    assert few.notes[0].endswith("(SD)")
    assert "x 0.4 mm, y 0.9 mm, z 1.7 mm" in predicted.notes[0]
    assert predicted.notes[0].endswith("(rms)")


def test_errors_and_coverage_are_of_the_frames_compared(knee, truth, predicted):
    assert predicted.verdict == "valid"
    off = predicted.value[:, :3] - 1e3 * truth.center
    assert predicted.errors["mean_distance"] == pytest.approx(np.linalg.norm(off, axis=1).mean())
    assert predicted.errors["y"] == pytest.approx(np.sqrt(np.mean(off[:, 1] ** 2)))
    assert predicted.coverage == dict.fromkeys(COORDINATES, 1.0)
    moved = truth.center.copy()
    moved[:20, 2] += 0.2
    half = replace(truth, center=moved).during([(truth.times[10], truth.times[39])])
    found = predict_motion(knee, fitted(), half, samples=4, dt=2e-3)
    assert found.compared.sum() == 30
    assert found.coverage["z"] == pytest.approx(20 / 30)
    assert (found.coverage["x"], found.coverage["tilt"]) == (1.0, 1.0)


def test_a_knee_that_starts_invalid_is_predicted_invalid(knee):
    found = predict_motion(knee.with_limits(least_upward_lines=2), fitted(), samples=2, dt=2e-3)
    assert found.verdict.startswith("INVALID: lines of force that pull the patella upward: 1 (at least 2")
    assert found.verdict.endswith("from the recorded start (at most 15: most_start_turn_deg)")


def test_draws_that_start_invalid_are_in_no_band(knee):
    """The bands are those of the other draws; beyond a tenth of such draws the prediction is INVALID."""
    draws = np.random.default_rng(5).normal(*np.array(list(VALUES.values())).T * [[1], [5]], size=(24, 3))
    turned = np.degrees([equilibrium(fitted().apply(knee, theta)).turned for theta in draws])
    beyond = np.sort(turned)[::-1]
    for lost, verdict in ((2, "valid"), (3, "INVALID: 3 of 24 draws have an INVALID motion")):
        limit = 0.5 * (beyond[lost - 1] + beyond[lost])
        near = knee.with_limits(most_start_turn_deg=float(limit), most_start_shift_mm=20.0)
        found = predict_motion(near, fitted(draws=draws), samples=24, dt=2e-3)
        assert found.verdict == verdict
        assert f"{lost} draws without a valid motion omitted" in found.notes
        others = predict_motion(knee, fitted(draws=draws[turned < limit]), samples=24 - lost, dt=2e-3)
        np.testing.assert_allclose(found.low, others.low, atol=1e-6)
        np.testing.assert_allclose(found.high, others.high, atol=1e-6)


def test_draws_beyond_a_limit_of_parameters_are_draws(knee):
    """Only the estimate itself is checked against these limits."""
    draws = np.random.default_rng(6).normal(*np.array(list(VALUES.values())).T, size=(12, 3))
    # Slack length over distance at the start: 0.871 is between the estimate's and the largest draw's.
    bounded = knee.with_limits(most_start_turn_deg=90.0, most_start_shift_mm=50.0, most_slack_share=0.871)
    with pytest.raises(InputError, match=r"patellar_tendon.*at most 0\.871"):
        check(fitted().apply(bounded, draws[np.argmax(draws[:, 1])]))
    found = predict_motion(bounded, fitted(draws=draws), samples=12, dt=2e-3)
    assert found.verdict == "valid"
    assert not any("omitted" in note for note in found.notes)


def test_synthetic_data_and_doubts_are_reported(knee, truth):
    doubted = fitted(doubts=["two springs swapped"], verdict="INVALID: no contact")
    found = predict_motion(knee, doubted, replace(truth, synthetic=True), samples=2, dt=2e-3)
    assert found.objection.startswith("INVALID: no contact (the fitted motion); two springs swapped")
    for note in (found.to_dict()["notes"][0], found.dataset().attrs["note"]):
        assert note.startswith(found.objection)
    assert "the parameters were estimated from synthetic measurements" in found.notes
    assert any("synthetic" in str(line.get_label()) for ax in found.figure().axes for line in ax.get_lines())


def test_measurements_of_another_clock_are_refused(knee, truth):
    with pytest.raises(InputError, match="was measured at"):
        predict_motion(knee, fitted(), replace(truth, times=truth.times + 0.3), samples=2)
    short = Measured(truth.times[:-1], truth.center[:-1])
    with pytest.raises(InputError, match="frames"):
        predict_motion(knee, fitted(), short, samples=2)


def test_one_number_by_another_of_its_names(knee):
    by_letter, by_name = (
        predict_motion(knee, fitted(), samples=1, dt=2e-3, values={name: 190.0})
        for name in ("K1", "quadriceps.stiffness")
    )
    np.testing.assert_allclose(by_name.value, by_letter.value)


def test_numbers_that_are_other_in_this_recording(knee):
    """One that was fitted, a range of it, and one that was not."""
    free = predict_motion(knee, fitted(), samples=12, dt=2e-3)
    fixed = predict_motion(knee, fitted(), samples=12, dt=2e-3, values={"K1": 190.0})
    own = simulate(fitted().apply(knee).set("K1", 190.0), dt=2e-3)
    np.testing.assert_allclose(fixed.value[:, :3], 1e3 * own.center, atol=1e-6)
    ranged = predict_motion(knee, fitted(), samples=12, dt=2e-3, values={"K1": (120.0, 260.0)})
    np.testing.assert_allclose(ranged.value, fixed.value, atol=1e-9)  # the middle of the range
    assert np.ptp([ranged.high, ranged.low], axis=0).max() > np.ptp([fixed.high, fixed.low], axis=0).max()
    heavy = predict_motion(knee, fitted(), samples=2, dt=2e-3, values={"patella.mass": 0.5})
    assert np.abs(heavy.value - free.value).max() > 0.01
    assert free.errors == free.coverage == {}


@pytest.mark.parametrize(
    ("estimate", "options", "words"),
    [
        (made_estimate(VALUES, rmse={"position": 1e-3, "X": 1e-3, "Y": 1e-3, "Z": 1e-3}), {}, "--use position,orient"),
        (fitted(), {"samples": 0}, "at least 1"),
        (fitted(), {"values": {"K1": (2.0, 1.0)}}, "2.0 to 1.0"),
        (fitted(), {"values": {"patella.mass": (0.1, 0.2)}}, "a range for a parameter that was not fitted"),
        (fitted(), {"values": {"K9": 1.0}}, "K9"),
        (fitted(), {"values": {"L2.strain": 0.1}}, "not as it was fitted; expected: the fit's name: L2"),
        (fitted(), {"values": {"K1": -3.0}}, "stiffness"),
        (fitted(), {"values": {"K1": (-300.0, 800.0)}}, "stiffness"),
        (fitted(rmse={"X": 1e-3}, channels=("position", "orientation")), {}, "fit again"),
    ],
)
def test_what_cannot_be_predicted(knee, estimate, options, words):
    with pytest.raises(InputError) as refused:
        predict_motion(knee, estimate, **options)
    assert words in str(refused.value)


def test_figure_and_files_name_what_they_hold(predicted):
    figure = predicted.figure()
    assert [ax.get_ylabel() for ax in figure.axes] == [f"{words} [{unit}]" for unit, words in COORDINATES.values()]
    data = predicted.dataset()
    np.testing.assert_allclose(data["high"].sel(coordinate="tilt"), predicted.high[:, 5])
    assert data.attrs["verdict"] == "valid"
    assert "90 % bands contain 100 %" in predicted.to_dict()["sentence"]


def test_a_coordinate_that_is_other_here_is_what_was_said_in_this_knee(knee):
    """Coordinates are fitted as offsets: in another knee the number itself is set, not the offset from the fit's."""
    other = knee.set(PLACE, 0.020)
    found = predict_motion(other, fitted(), samples=1, dt=2e-3, values={PLACE: 0.016})
    own = simulate(other.set("K1", 160.0).set("L2", 0.0715).set(PLACE, 0.016), dt=2e-3)
    np.testing.assert_allclose(found.value[:, :3], 1e3 * own.center, atol=1e-6)
