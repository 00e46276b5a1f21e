"""The catalogue of hard cases: that it is there, that cases are what they say, and that they hold."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from importlib import resources

import jax
import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases import (
    CONTACTS,
    INTEGRATORS,
    Selection,
    case_named,
    catalogue,
    method_named,
    run_matrix,
)
from pftwin.studies.hard_cases.batch import batches, built_scene
from pftwin.studies.hard_cases.case import Expected, HardCase
from pftwin.studies.hard_cases.contacts import contact_on
from pftwin.studies.hard_cases.knee import KneeNumbers
from pftwin.studies.hard_cases.table import MatrixPiece, by_case, counts, markdown, reasons, summary
from pftwin.studies.hard_cases.verdict import THOUGH_RIGHT, Cell


def test_there_are_as_many_cases_as_were_asked_for():
    names = [c.name for c in catalogue()]
    assert len(names) >= 36
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("case", catalogue(), ids=lambda c: c.name)
def test_a_case_says_what_is_hard_and_what_is_expected(case):
    assert len(case.about) > 15
    assert case.about.endswith(".")
    assert set(case.contacts) <= set(CONTACTS)
    assert case.contacts
    if case.expected.same_as is not None:
        assert case_named(case.expected.same_as).group == case.group


def test_the_table_of_cases_has_no_word_that_is_not_read():
    known = {f.name for kind in (HardCase, Expected) for f in fields(kind)} - {"topic", "builder", "expected"}
    known = known - {"smooth", "symmetric", "still"} | {"holds", "knee", "seed", "change", "rig", "factors"}
    text = resources.files("pftwin.studies.hard_cases").joinpath("cases.toml").read_text(encoding="utf-8")
    topics = tomllib.loads(text)
    texts = topics.pop("texts")
    said = []
    for entries in topics.values():
        for entry in entries:
            assert set(entry) <= known, entry["name"]
            said += [entry[key] for key in ("limit", "unmended") if key in entry]
    assert {text for text in said if said.count(text) > 1} == set(texts)  # whatever is said twice stands once


def test_what_several_cases_share_is_said_of_each():
    hard, plain = case_named("contact_hard"), case_named("plain_knee")
    assert hard.limit.startswith("by contours, in float32, the search for the equilibrium ends before its balance")
    assert plain.unmended.startswith("By contours, in float32. Neighbouring motions diverge")


def test_changes_reach_the_numbers_that_they_name():
    knee = case_named("tendon_stiff").builder()
    assert (knee.patellar_tendon.stiffness, knee.quadriceps) == (5e5, KneeNumbers().quadriceps)
    dropped = case_named("bounce_to_rest")
    assert dropped.builder().start == (0.0, 0.0, 0.025)
    assert dropped.expected.symmetric
    assert not dropped.expected.smooth


def test_a_name_that_is_none_is_refused():
    with pytest.raises(InputError, match="no case 'soft'"):
        case_named("soft")


@pytest.mark.parametrize("contact", ["P5", "contours", "volume"])
def test_what_cannot_be_simulated_is_refused_in_words(contact):
    for case in catalogue():
        if case.expected.refusal is None or contact not in case.contacts:
            continue
        with pytest.raises(InputError) as error:
            built_scene(case, contact)
        assert case.expected.refusal in str(error.value), case.name


@pytest.mark.parametrize("contact", [c if c == "P5" else pytest.param(c, marks=pytest.mark.slow) for c in CONTACTS])
def test_cases_of_one_group_have_one_structure(contact):
    stacks, refused = batches(catalogue(), contact)
    assert sum(len(b.cases) for b in stacks) + len(refused) == sum(contact in c.contacts for c in catalogue())
    assert {b.cases[0].group for b in stacks} <= {"short", "long", "one triangle", "rig"}


SMALL = (  # a few of every topic; the slow tests of the matrix have them all
    "plain_knee", "quaternion_signs_flip", "bounce_to_rest", "contact_hard", "tendon_stiff", "tendon_jerks_taut",
    "rest_in_the_groove", "sphere_on_a_ridge", "step_of_5_ms", "at_random_1", "mass_zero", "motion_uneven",
)  # fmt: skip


def test_every_cell_is_counted_once_while_the_matrix_runs():
    """Two scenes that are refused, on P5 and P2: by newmark in two float types, by ali3p in one and on P5 alone."""
    chosen = Selection(("P5", "P2"), (method_named("newmark"), method_named("ali3p")))
    cases, counts = [case_named("mass_zero"), case_named("motion_uneven")], []
    cells = run_matrix(cases, chosen, count=counts.append)
    assert chosen.cells_of(cases) == sum(counts) == len(cells) == 2 * (2 + 1 + 2)


@pytest.fixture(scope="module")
def cells() -> list[Cell]:
    """One contact and the default integrator, with derivatives."""
    chosen = Selection(("P5",), (method_named("linear_implicit"),), ("float64",), batch_independence=False)
    counts: list[int] = []
    found = run_matrix([case_named(name) for name in SMALL], chosen, count=counts.append)
    assert sum(counts) == len(found) == chosen.cells_of([case_named(name) for name in SMALL])
    return found


@pytest.mark.slow
def test_a_small_set_holds_on_a_patch_with_the_default_integrator(cells):
    stepped_over = "tendon_jerks_taut"  # a converged run says so too
    expected = dict.fromkeys(SMALL, "pass") | dict.fromkeys((*SMALL[-2:], stepped_over), "refused")
    assert {c.case: c.outcome for c in cells} == expected
    (reason,) = (c.reason for c in cells if c.case == stepped_over)
    assert reason.startswith(Status.INACCURATE.describe())
    assert THOUGH_RIGHT not in reason


@pytest.mark.slow
def test_runs_do_not_depend_on_their_batch():
    """Side by side, in another order, beside members whose every number is NaN. A bounce's largest force is right, but
    the run with twice the step misses it, so that it is reported as not known."""
    cases = [case_named(n) for n in ("plain_knee", "bounce_to_rest", "tendon_reversed", "contact_hard", "noise")]
    method = method_named("linear_implicit_bdf2")
    cells = run_matrix(cases, Selection(("P5",), (method,), ("float64",), derivatives=False))
    reasons = {c.case: c.reason for c in cells}
    bounce = reasons.pop("bounce_to_rest")
    assert bounce.startswith(Status.PEAK_UNKNOWN.describe())
    assert THOUGH_RIGHT in bounce
    assert list(reasons.values()) == [""] * 4


@pytest.mark.slow
def test_tables_count_every_cell_once(cells):
    assert sum(counts(cells).values()) == len(cells)
    (row,) = summary(cells).rows
    assert sum(int(x) for x in row[3:]) == len(cells)
    assert len(by_case(cells).rows) == len({c.case for c in cells})
    machine = {"cpu": "a", "cores": 1, "jax": "0", "date": "2026-01-01T10:00+00:00"}
    page = markdown(cells, catalogue(), [MatrixPiece(tuple(cells), 60.0, machine, False, True)])
    cases = len({c.case for c in cells})
    assert f"| 2026-01-01T10:00 | 1.0 | P5 | linear_implicit | float64 | {cases} | everything |" in page
    assert all(f"**{c.name}**" in page for c in catalogue())
    assert all(row[0] in page for row in reasons(cells, "fail").rows)


def test_float32_scenes_are_single_throughout():
    with jax.enable_x64(False):
        stacks, _ = batches([case_named("plain_knee")], "P5")
        kinds = {np.asarray(a).dtype for a in jax.tree.leaves(stacks[0].scenes)}
    assert kinds == {np.dtype(np.float32)}


def test_a_contact_is_made_anew_for_each_float_type():
    with jax.enable_x64(False):
        single = contact_on(case_named("plain_knee").builder(), "contours")
    double = contact_on(case_named("plain_knee").builder(), "contours")
    assert single.law.contact_stiffness.dtype == np.float32  # pyright: ignore
    assert double.law.contact_stiffness.dtype == np.float64  # pyright: ignore


def test_the_command_writes_json_and_the_page(tmp_path):
    from typer.testing import CliRunner

    from pftwin.cli.program import app

    page, data = tmp_path / "page.md", tmp_path / "cells.json"
    args = ["--case", "mass_zero", "--case", "radius_negative", "--contact", "P5", "--dtype", "float64"]
    done = CliRunner().invoke(app, ["hard-cases", *args, "--json", str(data), "--markdown", str(page)])
    assert done.exit_code == 0, done.output
    count = 2 * len(INTEGRATORS)
    assert f"2 cases, {count} cells: 0 pass, 0 fail, {count} refused." in page.read_text(encoding="utf-8")
    assert '"outcome": "refused"' in data.read_text(encoding="utf-8")
    again = tmp_path / "again.md"
    done = CliRunner().invoke(app, ["hard-cases", "--from", str(data), "--from", str(data), "--markdown", str(again)])
    assert done.exit_code == 0, done.output
    assert f"{count} cells: 0 pass, 0 fail, {count} refused." in again.read_text(encoding="utf-8")
    wrong = CliRunner().invoke(app, ["hard-cases", "--contact", "P99"])
    assert wrong.exit_code == 2
    assert "expected: one of: P2" in " ".join(wrong.output.split())
