"""Options of commands that fit, with units."""

from __future__ import annotations

import pytest
from small_scene import small_scene

from fitting.cli.fit_options import FitOptions
from pftwin.base.errors import InputError
from pftwin.cli.scenes import seconds


def test_numbers_take_units_by_what_they_are():
    options = FitOptions(noise=["position=0.2 mm", "orientation=90 deg"], varies=["L1=0.5 mm"], bounds=["L1=14:15 cm"])
    asked = options.asked(small_scene(5))
    assert asked["noise"] == pytest.approx({"position": 2e-4, "orientation": 1.5707963267948966})
    assert asked["varies"] == pytest.approx({"L1": 5e-4})
    assert asked["bounds"] == {"L1": pytest.approx((0.14, 0.15))}
    assert FitOptions(bounds=["0.2"]).asked(small_scene(5))["bounds"] == 0.2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"noise": ["position=2 N"]}, "--noise: found 'position=2 N'.* in m or with a unit: mm"),
        ({"varies": ["K1=2 mm"]}, "--varies: found 'K1=2 mm'.* in N/m"),
        ({"bounds": ["K9=1:2"]}, "K9"),
    ],
)
def test_units_of_another_kind_and_unknown_names_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        FitOptions(**options).asked(small_scene(5))


def test_steps_may_be_in_milliseconds():
    assert seconds("0.5 ms") == pytest.approx(5e-4)
    with pytest.raises(InputError, match="--dt: found '1 mm'"):
        seconds("1 mm")
