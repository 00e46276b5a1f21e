"""What no fit can answer is named."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from lifted_fits import FEW, clean, scene, truth

import fitting
import fitting.fit
import pftwin
from pftwin.base.errors import InputError, PftwinError
from pftwin.model.measured import Measured


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"method": "simplex"}, "no method 'simplex'"),
        ({"objective": "likely"}, "no objective"),
        ({"loss": "huge"}, "no loss"),
        ({"loss": "huber"}, "needs the measurements' noise"),
        ({"use": ("orientation",)}, "no 'orientation' was measured"),
        ({"use": ("magic",)}, "no channel 'magic'"),
        ({"objective": "paper", "use": ("quadriceps",)}, "position alone"),
        ({"objective": "paper", "priors": {"K1": (1.0, 1.0)}}, "no noise to weigh"),
        ({"noise": {"orientation": 1.0}}, "no noise of 'position'"),
        ({"noise": {"position": -1.0}}, "positive number"),
        ({"free": ("K9",)}, "no parameter"),
        ({"bounds": {"K1": (1.0, 2.0)}}, "exclude"),
        ({"starts": 0}, "at least 1"),
        ({"starts": 10**9}, "starts: found 1000000000; expected: a whole number, at least 1, at most 1,000,000"),
        ({"seed": -1}, "seed: found -1; expected: a whole number from 0 to"),
        ({"seed": 2**64, "method": "cma_es"}, "seed: found 18446744073709551616"),
        ({"generations": 5}, "no option 'generations'"),
        ({"resume": True}, "nothing to resume"),
        ({"computed": ("position", "magic")}, "computed: no channel 'magic'.*quadriceps"),
        (
            {"free": ("K1", "contact.center.z"), "bounds": {"contact.center.z": (-0.01, 0.03)}},
            "contact.center.z moves the point of the patella whose path was measured",
        ),
        ({"free": ("quadriceps.insertion.z~contact.center.z",)}, "moves the point of the patella"),
        (
            {"nuisance": fitting.Nuisance(others={"contact.center.x": 1e-3})},
            "contact.center.x moves the point of the patella whose path was measured",
        ),
        ({"computed": ("quadriceps",)}, "computed: without position, which the fit compares"),
    ],
)
def test_mistakes_are_named(arguments, said):
    with pytest.raises(InputError, match=said):
        fitting.fit_tendons(scene(), clean(), **arguments)


@pytest.mark.slow
def test_measurements_of_another_length_rate_or_frame():
    far = np.median(np.linalg.norm(truth().center + 0.2 - pftwin.simulate(scene()).center, axis=1))
    for times, center, said in (
        (truth().times[:-1], truth().center[:-1], "40 frames at 100 Hz"),
        (2 * truth().times, truth().center, "was measured at"),
        (truth().times, truth().center * 1000, "measured positions look 1000 times too large: in millimetres"),
        (truth().times, truth().center + 0.2, f"measured positions lie {1e3 * far:.0f} mm from the scene's"),
        (truth().times, np.full_like(truth().center, np.nan), "no 'position' was measured"),
    ):
        with pytest.raises(InputError, match=said):
            fitting.fit_tendons(scene(), Measured(times, center), **FEW)


def test_a_scene_that_is_no_case_needs_measurements():
    with pytest.raises(InputError, match="nothing to compare with"):
        fitting.fit_tendons(scene())


def test_a_missing_extra_is_named(monkeypatch):
    from fitting.methods import strategies

    strategies._algorithm.cache_clear()
    monkeypatch.setitem(sys.modules, "evosax", None)
    with pytest.raises(PftwinError, match=r"pftwin\[evosax\]"):
        fitting.fit_tendons(scene(), clean(), method="cma_es", population=11)
