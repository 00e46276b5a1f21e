"""A marker on the patella: where rotation and position say, without any pull; read from files, compared, drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scene import small_result, small_scene, vec

import pftwin
from pftwin.base.errors import InputError
from pftwin.model.effects.marker import Marker
from pftwin.model.measured import Measured

POINT = (0.021, 0.013, 0.009)
FRAMES = 41  # as in `small_result`, and in other tests of markers: one program serves them all


@pytest.fixture(scope="module")
def result() -> pftwin.Result:
    return pftwin.simulate(small_scene(FRAMES).with_effect(Marker(vec(*POINT), name="m1")))


def test_it_is_where_the_pose_says(result: pftwin.Result) -> None:
    turned = Rotation.from_quat(result.quaternion, scalar_first=True).apply(np.array(POINT))
    seen = np.stack([result.effects["m1"][axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(seen, result.position + turned, rtol=0, atol=1e-12)


def test_it_pulls_at_nothing(result: pftwin.Result) -> None:
    without = small_result()
    np.testing.assert_allclose(result.center, without.center, rtol=0, atol=1e-12)
    assert result.to_dataset()["m1_x"].attrs["units"] == "m"


def test_measurements_of_it_are_compared(result: pftwin.Result) -> None:
    x = np.array(result.effects["m1"]["x"]) + 0.003 * np.where(np.arange(FRAMES) % 2, 1.0, -1.0)
    x[4:6] = np.nan
    force = result.effects["contact"]["force_medial"] - 0.75
    measured = Measured(result.times, result.center, readings={"m1.x": x, "contact.force_medial": force})
    rows = {row.key: row for row in pftwin.validate(result, measured).to_rows()}
    assert (rows["m1.x"].value, rows["m1.x"].unit) == (pytest.approx(3.0), "mm")
    assert (rows["contact.force_medial"].value, rows["contact.force_medial"].unit) == (pytest.approx(0.75), "N")
    figure = result.plot.compared(measured)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert any("m1" in label and "[mm]" in label for label in labels)
    drawn = [line.get_ydata() for ax in figure.axes for line in ax.get_lines()]
    assert any(np.shape(y) == (FRAMES,) and np.allclose(y, 1e3 * x, equal_nan=True) for y in drawn)


def test_what_an_effect_does_not_report_is_refused(result: pftwin.Result) -> None:
    for name, said in (("m1.w", "one of: m1.x, m1.y, m1.z"), ("m7.x", "one of: gravity.weight")):
        with pytest.raises(InputError, match=f"(?s)no observable '{name}'.*{said}"):
            pftwin.validate(result, Measured(result.times, result.center, readings={name: np.zeros(FRAMES)}))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"readings": {"m1.x": np.zeros(20)}}, r"m1.x of shape \(20,\)"),
        ({"readings": {"m1.x": np.full(FRAMES, np.inf)}}, "row 1 of m1.x is infinite"),
        ({"weights": np.full(FRAMES, -1.0)}, "row 1 of weights is -1"),
        ({"weights": np.full(FRAMES, np.nan)}, "row 1 of weights is nan"),
        ({"weights": np.ones((FRAMES, 1))}, r"weights of shape \(41, 1\)"),
    ],
)
def test_numbers_that_are_none_are_refused(result: pftwin.Result, changes: dict, said: str) -> None:
    with pytest.raises(InputError, match=f"(?s){said}"):
        Measured(result.times, result.center, **changes)


def test_measurements_with_other_readings_or_weights_are_others(result: pftwin.Result) -> None:
    plain = {"times": result.times, "center": result.center}
    same = [Measured(**plain, readings={"m1.x": np.zeros(FRAMES)}, weights=np.ones(FRAMES)) for _ in range(2)]
    assert same[0] == same[1]
    for changed in (
        {"readings": {"m1.x": np.ones(FRAMES)}},
        {"readings": {"m1.y": np.zeros(FRAMES)}},
        {"weights": np.zeros(FRAMES)},
    ):
        given = {"readings": {"m1.x": np.zeros(FRAMES)}, "weights": np.ones(FRAMES), **changed}
        assert Measured(**plain, **given) != same[0]
