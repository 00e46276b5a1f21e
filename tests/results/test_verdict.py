"""No statement about tracking without equilibrium, contact and a motion that may be trusted."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from small_scene import small_result, small_scene

import pftwin
from pftwin.dynamics.status import FLAGS, Status
from pftwin.results.verdict import Verdict, is_invalid, verdict_of, verdict_of_file
from pftwin.studies.audit.audit import audit
from pftwin.studies.audit.report import audit_sheet


def in_the_air():
    """The small knee with its groove 100 mm behind the button."""
    scene, place = small_scene(), lambda s: s.contact.surface.chart.origin.z
    return eqx.tree_at(place, scene, place(scene) - 0.1)


def flagged(counts: dict[Status, int]):
    """The small knee's result with the first frames flagged."""
    result = small_result()
    flags = np.zeros_like(result.flags)
    for flag, count in counts.items():
        flags[:count] |= int(flag)
    return dataclasses.replace(result, flags=flags)


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        (in_the_air(), "the button touches nothing (41 of 41 frames)"),
        (small_scene().set("quadriceps.slack_length", 143.0), "did not start from a converged equilibrium"),
        pytest.param(
            small_scene(11).without("quadriceps"),
            "did not start from a converged equilibrium",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["nothing is touched", "a slack length of 143 m", "no quadriceps"],
)
def test_such_a_motion_is_invalid_and_nothing_is_said_of_its_tracking(scene, why):
    result = pftwin.simulate(scene)
    summary = result.summary()
    assert summary.startswith("INVALID: ")
    assert why in summary.splitlines()[0]
    assert "tracking" not in summary
    assert "clean" not in summary
    assert "indentation: -" not in summary
    assert result.largest_indentation >= 0
    assert result.dislocations() is None
    data = result.to_dataset()
    for name in ("tracking", "verdict"):
        assert data.attrs[name].startswith("INVALID: ")
    assert "dislocated" not in data
    assert "groove_offset" in data


def test_a_sound_motion_is_spoken_of():
    result = small_result()
    assert result.verdict.valid
    assert "tracking: normal tracking" in result.summary()
    assert result.to_dataset().attrs["verdict"] == "valid"


@pytest.mark.parametrize("flag", FLAGS)
def test_which_flags_forbid_it(flag):
    told, in_part = (
        {Status.LEFT_PATCH, Status.SNAPPED, Status.FACETS_INACCURATE},
        {Status.NO_CONTACT, Status.INACCURATE},
    )
    n = small_result().times.size
    assert flagged({flag: n}).verdict.valid == (flag in told)
    assert flagged({flag: 1}).verdict.valid == (flag in told | in_part)
    assert flagged({Status.INACCURATE: n // 10}).verdict.valid
    assert not flagged({Status.INACCURATE: n // 10 + 1}).verdict.valid
    assert flagged({Status.NO_CONTACT: n // 2}).verdict.valid
    assert not flagged({Status.NO_CONTACT: n // 2 + 1}).verdict.valid


def test_one_rule_for_one_motion_and_for_many():
    rng = np.random.default_rng(3)
    flags = rng.choice([0, *map(int, FLAGS)], size=(300, 4), p=[0.6, *[0.4 / len(FLAGS)] * len(FLAGS)])
    counts = np.stack([np.count_nonzero(flags & int(f), axis=1) for f in FLAGS], axis=1)
    alone = [not verdict_of(row).valid for row in flags]
    assert is_invalid(counts, 4).tolist() == alone
    assert 0 < sum(alone) < 300


def test_a_summary_gives_the_reason_of_its_verdict_once():
    result = flagged({Status.INACCURATE: 20, Status.FACETS_INACCURATE: 2})
    assert result.verdict.flags == Status.INACCURATE
    invalid = result.summary()
    assert invalid.count(Status.INACCURATE.describe()) == 1  # in the verdict, and not once more as a status
    assert f"status: 2 of 41 frames: {Status.FACETS_INACCURATE.describe()}" in invalid


def test_a_harmless_remark_is_the_last_line():
    lines = flagged({Status.LEFT_PATCH: 3}).summary().splitlines()
    assert lines[-1].startswith("remark: 3 of 41 frames: a loaded contact lies outside the fitted surface")
    assert not any("outside the fitted surface" in line for line in lines[:-1])
    assert "tracking: normal tracking" in lines
    assert "status: all frames clean" not in lines


def test_a_file_keeps_its_verdict_and_an_older_one_gets_it_from_its_status():
    data = flagged({Status.NOT_FINITE: 2}).to_dataset()
    assert verdict_of_file(data).describe() == data.attrs["verdict"]
    del data.attrs["verdict"]
    assert "not finite" in verdict_of_file(data).describe()
    assert verdict_of_file(small_result().to_dataset()) == Verdict()


@pytest.mark.slow
def test_an_audit_of_such_a_scene_says_so_first_and_weighs_nothing():
    found = audit(in_the_air(), only=["gravity"])
    assert found.verdict.startswith("INVALID: ")
    assert found.tracking == found.verdict
    assert audit_sheet(found).title.startswith("INVALID: ")
    assert {row.verdict for row in found.rows} == {"INVALID"}


def test_pages_of_such_a_motion_begin_with_it():
    pytest.importorskip("k3d")
    from pftwin.results.viewer import page
    from pftwin.results.viewer.recorded import recorded

    shown = recorded([flagged({Status.STEP_TOO_LONG: 1})])
    assert page.title(shown) == "INVALID: small knee"
    assert page.notes(shown, 1.0)[0].startswith("INVALID: the patella moves or turns too far")
    assert page.title(recorded([small_result()])) == "small knee"


@pytest.mark.slow
def test_one_contact_of_several_that_bears_is_contact():
    """A second button that never reaches the trochlea changes nothing of the first."""
    scene = small_scene(11)
    far = eqx.tree_at(lambda c: c.surface.chart.origin.z, scene.contact, scene.contact.surface.chart.origin.z - 0.1)
    both = dataclasses.replace(scene, effects=(*scene.effects, dataclasses.replace(far, name="second")))
    result = pftwin.simulate(both)
    assert result.verdict.valid, result.verdict.describe()
    assert result.effects["second"]["force"].max() == 0
    assert result.effects["contact"]["force"].min() > 0
