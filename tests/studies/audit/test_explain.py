"""What is said of a scene's effects is true: energies close, stiffness is that of the mechanics, shares are of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes import MASS, G, J, gravity, knee, look, system, tendon

from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.simulate import settle_first_frame, simulate
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.friction import Friction
from pftwin.model.scene import Scene
from pftwin.studies.audit import explain as module
from pftwin.studies.audit.account import account, equations, rates
from pftwin.studies.audit.explain import Explanation, PartCost, explain
from pftwin.studies.audit.report import explanation_sheet
from pftwin.studies.runs import Cost, time_in_turn

FRAMES = 21


def rough() -> Scene:
    smooth = knee(FRAMES)
    return smooth.with_effect(smooth.effect("contact").with_friction(Friction(J(0.1), J(5e-3))))


@pytest.fixture(scope="module")
def calls() -> list[tuple[int, int, str]]:
    """What the explanation below tells while it is made."""
    return []


@pytest.fixture(scope="module")
def found(calls) -> Explanation:
    return explain(rough(), progress=lambda *now: calls.append(now))


@pytest.mark.slow
def test_what_is_explained_is_what_is_simulated(found):
    result = simulate(rough())
    assert (found.integrator, found.step) == (result.settings["integrator"], result.settings["dt_s"])
    np.testing.assert_array_equal(found.flags, result.flags)
    assert found.verdict == result.verdict.describe()
    doubted = explanation_sheet(replace(found, verdict="INVALID: no equilibrium"))
    assert doubted.title.startswith("INVALID: no equilibrium\n")


@pytest.mark.slow
def test_progress_is_reported(found, calls):
    assert [(done, of) for done, of, _ in calls] == [(k, 8) for k in range(9)]
    assert [what for _, _, what in calls[3:8]] == [f"without {part.name}" for part in found.parts]


@pytest.mark.slow
def test_every_part_has_a_row_and_friction_its_own(found):
    assert [p.name for p in found.parts] == ["gravity", "quadriceps", "patellar_tendon", "contact", "contact: friction"]
    assert found.parts[-1].of == "contact"
    assert found.steps == 10 * (FRAMES - 1)


@pytest.mark.slow
def test_works_add_up_to_the_kinetic_energy(found):
    moved = sum(p.moved for p in found.parts)
    assert moved > 1e-4
    assert abs(found.energy_gap) < 0.02 * moved
    assert all(p.moved >= abs(p.work) for p in found.parts)


@pytest.mark.slow
def test_only_what_damps_makes_heat(found):
    heat = {p.name: p.heat for p in found.parts}
    assert heat["gravity"] == 0
    assert heat["quadriceps"] > 0
    assert 0 < heat["contact: friction"] <= heat["contact"]


@pytest.mark.slow
def test_equations_add_up(found):
    assert found.equations == equations(rough(), BDF2())
    assert found.equations == found.shared_equations + sum(p.equations for p in found.parts if p.of is None)
    friction = found.parts[-1]
    assert 0 < friction.equations < found.parts[-2].equations


@pytest.mark.slow
def test_the_contact_takes_most_of_the_time_and_is_stiff(found):
    by_name = {p.name: p for p in found.parts}
    assert by_name["contact"].stiff
    assert not by_name["gravity"].stiff
    assert by_name["gravity"].longest_step == np.inf
    assert by_name["contact"].share == max(p.share for p in found.parts) > 0.2
    assert found.step_time > 0


@pytest.mark.slow
def test_plain_values(found):
    assert json.loads(json.dumps(found.to_dict(), default=str))["parts"][3]["name"] == "contact"
    sheet = explanation_sheet(found)
    assert "- of which friction" in sheet.markdown()
    assert sheet.tables(200)[0].row_count == len(found.parts) + 2


def test_the_table_has_units_in_its_head_and_numbers_below():
    spring = PartCost("spring", "Tendon", None, 273, 0.25, 0.012, 2e-3, False, -0.5, 2.5, 1e-12)
    made = Explanation("knee", "bdf2", 1e-3, 40, 1000, 2e-6, (spring,), 0.002, np.zeros(5, dtype=np.int32), "valid", 5)
    sheet = explanation_sheet(made)
    of_spring, rest, whole = (dict(zip(sheet.headings, row, strict=True)) for row in sheet.rows)
    assert of_spring == {
        "effect": "spring", "computed by": "Tendon", "equations": "273", "time [%]": "25.0 ± 1.2",
        "longest explicit step [ms]": "2", "stiff": "no", "work [mJ]": "-500", "absolute work [mJ]": "2,500",
        "heat [mJ]": "0",
    }  # fmt: skip
    assert (rest["equations"], rest["time [%]"]) == ("727", "75")
    assert (whole["equations"], whole["time [%]"]) == ("1000", "100")
    notes = " ".join(sheet.notes)
    assert "a step, of 2.00 us" in notes
    assert "kinetic energy, 2 mJ, with an error of -502 mJ" in notes  # -500 - 2


def test_the_longest_explicit_step_is_that_of_the_oscillator():
    k, c = 300.0, 2.0
    hanging = system(tendon(k, 0.05, 0.0, origin=(0, 0, 0.1)))
    load = hanging.effects[0].load(look(), None)[0]
    np.testing.assert_allclose(rates(hanging, [(1.0, load)]).longest_step(), 2 / np.sqrt(k / MASS), rtol=1e-12)
    damped = system(tendon(k, 0.05, c, origin=(0, 0, 0.1)))
    load = damped.effects[0].load(look(), None)[0]
    h, w2, y = float(rates(damped, [(1.0, load)]).longest_step()), k / MASS, c / MASS
    roots = np.roots([1.0, -(2 - h * y - h * h * w2), 1 - h * y])
    np.testing.assert_allclose(np.abs(roots).max(), 1.0, rtol=1e-9)  # on the limit of stability


def test_drags_and_weight():
    drag, weight = LinearDamping(J(0.0), J(1e-3), body="femur"), gravity()
    both = system(drag, weight, inertia=(3e-5, 3e-5, 3e-5))
    loads = [e.load(look(), None)[0] for e in both.effects]
    expected = 2 * 3e-5 / 1e-3 / np.sqrt(3)  # the norm counts all three turns
    np.testing.assert_allclose(rates(both, [(1.0, loads[0])]).longest_step(), expected, rtol=1e-12)
    assert rates(both, [(1.0, loads[1])]).longest_step() == np.inf
    assert loads[1].total().force.z == pytest.approx(-MASS * G)


def test_without_one_of_a_sum_nothing_is_left():
    two = system(tendon(300.0, 0.05, 1.0, insertion=(0.01, 0, 0), origin=(0, 0, 0.1)))
    load = two.effects[0].load(look(), None)[0]
    assert rates(two, [(1.0, load), (-1.0, load)]).longest_step() == np.inf


def test_times_are_relative_to_the_first():
    def busy(n: int):
        return lambda: sum(range(n))

    one, three = time_in_turn([busy(100_000), busy(300_000)])
    assert one.ratio == 1.0
    assert 2 < three.ratio < 4


@pytest.mark.slow
def test_shares_of_time_follow_from_runs_without_the_part(monkeypatch):
    """Quiet times make exact shares: whatever the machine does."""
    monkeypatch.setattr(module, "time_in_turn", lambda runs, before: [Cost(1.0, 1.0, 0.0)] + [Cost(0.6, 0.6, 0.01)] * 5)
    again = explain(rough())
    assert [p.share for p in again.parts] == pytest.approx([0.4] * 5)
    assert again.shared_time == pytest.approx(1 - 4 * 0.4)


@pytest.mark.slow
def test_gravity_does_the_work_of_its_potential(found):
    plain = rough().unnamed()
    z = account(plain, settle_first_frame(plain)[0].answer, LinearImplicit(), 10).states.position.z
    np.testing.assert_allclose(found.parts[0].work, -MASS * G * (z[-1] - z[0]), atol=0.02 * found.parts[0].moved)
