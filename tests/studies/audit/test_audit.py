"""What an audit says: changes are measured right, lost runs are told, verdicts go by the tolerance, files hold it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from figure_parts import footers
from scenes import RADIUS, gravity, knee
from small_scene import small_result, small_scene
from test_variants import hung
from typer.testing import CliRunner

from pftwin import simulate
from pftwin.base.errors import InputError
from pftwin.base.spatial import Quaternion
from pftwin.cli import app
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.rebound import Impact
from pftwin.dynamics.status import Status, status_facts
from pftwin.model.measured import SYNTHETIC
from pftwin.model.scene import Scene
from pftwin.results.result import Result
from pftwin.studies.audit.audit import Audit, _outcome, _verdict, audit
from pftwin.studies.audit.report import audit_figure, audit_sheet, columns, dataset
from pftwin.studies.audit.runs import compare_runs, run_alone, run_side_by_side, why_incomparable
from pftwin.studies.audit.variants import Variant

FRAMES, SUBSTEPS = 11, 2


def scene() -> Scene:
    """Three tendons and weight."""
    return hung()


@pytest.fixture(scope="module")
def calls() -> list[tuple[int, int, str]]:
    """What the audit below tells while it runs."""
    return []


@pytest.fixture(scope="module")
def found(calls) -> Audit:
    """Tendons alone hold it, and few rows are wanted: of its programs none takes long to compile."""
    wanted = ("gravity", "tendons' damping", "patella inertia x 2", "steps half as long", "friction")
    return audit(scene(), only=wanted, progress=lambda *now: calls.append(now))


@pytest.fixture(scope="module")
def whole() -> Audit:
    """All rows that there are."""
    return audit(scene(), dt=0.01 / SUBSTEPS)


@pytest.fixture(scope="module")
def own() -> Result:
    return small_result()


def row(found: Audit, name: str):
    return next(r for r in found.rows if r.name == name)


@pytest.mark.slow
def test_every_variant_has_its_row(whole):
    names = {"gravity", "t0", "t1", "t2", "tendons' damping", "patella inertia", "toe region", "steps half as long"}
    assert names <= {r.name for r in whole.rows}
    assert {v.name: v.reason for v in whole.not_applicable}["friction"] == "nothing touches"
    assert [r.kind for r in whole.rows] == sorted(
        [r.kind for r in whole.rows], key=["left out", "added", "changed", "yardstick"].index
    )
    assert whole.programs == 1 + 6 + 8 + 1  # simulate's; structures' equilibria; motions; those that differ in numbers


@pytest.mark.slow
def test_without_inertia_what_stands_still_stays(whole):
    moved = row(whole, "patella inertia").changes
    assert moved is not None
    assert moved.center_max < 1e-8


def test_rows_that_are_wanted_stand_by_their_kind(found):
    kinds = [(r.name, r.kind) for r in found.rows]
    assert kinds == [
        ("gravity", "left out"),
        ("tendons' damping", "left out"),
        ("patella inertia x 2", "changed"),
        ("steps half as long", "yardstick"),
    ]
    assert [(v.name, v.reason) for v in found.not_applicable] == [("friction", "nothing touches")]
    assert found.programs == 1 + 2 + 3 + 1  # simulate's; equilibria with weight and without; motions; numbers differ


def test_progress_is_reported(found, calls):
    """Two rows that differ in numbers only run together, two alone; before and after them the scene itself."""
    assert [what for _, _, what in calls] == [
        *["the scene itself"] * 2,
        "2 that differ in numbers",
        *("gravity", "steps half as long"),
        *["times, in turn"] * 2,
    ]
    assert [(done, of) for done, of, _ in calls] == [(k, 6) for k in range(7)]


def test_what_is_audited_is_what_is_simulated(found):
    """The same integrator, the step that the errors ask for, and the same said of trust."""
    result = simulate(scene())
    assert (found.integrator, found.step) == (result.settings["integrator"], result.settings["dt_s"])
    assert found.verdict == result.verdict.describe()
    assert {"status": found.status, "status_frames": found.status_frames} == status_facts(result.flags)


def test_weight_moves_it_by_what_statics_says(found):
    """A femur that stands still and tendons of it: the change is that of the equilibrium."""
    import pftwin

    with_it, without = (pftwin.equilibrium(s).position for s in (scene(), scene().without("gravity")))
    moved = row(found, "gravity").changes
    assert moved.center_rms == pytest.approx(np.linalg.norm(with_it - without), rel=1e-4)
    assert moved.center_rms > 1e-4
    assert row(found, "gravity").verdict == "worth keeping"


def test_what_stands_still_needs_neither_damping_nor_inertia(found):
    for name in ("tendons' damping", "patella inertia x 2"):
        assert row(found, name).changes.center_max < 1e-8
    assert row(found, "tendons' damping").verdict == "can be left out"
    assert row(found, "tendons' damping").cost is None
    assert row(found, "steps half as long").verdict == "steps short enough"
    assert row(found, "steps half as long").cost is not None


def test_effects_that_hold_the_patella_are_indispensable(found):
    lost_ones = [r for r in found.rows if r.changes is None]
    assert {r.kind for r in lost_ones} <= {"left out"}
    for r in lost_ones:
        assert r.verdict == "indispensable"
        assert r.outcome
    everything = audit_sheet(replace(found, synthetic=True))
    assert SYNTHETIC in everything.notes
    assert SYNTHETIC not in audit_sheet(found).notes
    assert everything.tables(200)[0].row_count == len(found.rows)


def test_changes_are_those_that_were_made(own):
    shifted = replace(own, position=own.position + np.array([3e-3, 0, 4e-3]))
    made = compare_runs(small_scene(), shifted, own)
    assert made.center_rms == pytest.approx(5e-3)
    assert made.center_max == pytest.approx(5e-3)
    assert made.flexion == made.contact_rms == made.tension_rms == 0
    turn = np.array([np.cos(0.05), 0.0, np.sin(0.05), 0.0])  # about the lateral axis
    quaternion = (Quaternion(*own.quaternion.T) * Quaternion(*turn)).array()
    turned = compare_runs(small_scene(), replace(own, quaternion=np.asarray(quaternion)), own)
    assert turned.flexion == pytest.approx(0.1, rel=0.02)
    assert turned.center_max < 1e-12  # about the button's centre, which is the origin
    stronger = {**own.effects, "quadriceps": {"tension": own.effects["quadriceps"]["tension"] + 2.0}}
    pulled = compare_runs(small_scene(), replace(own, effects=stronger), own)
    assert (pulled.tension_of, pulled.tension_rms) == ("quadriceps", pytest.approx(2.0))
    without = {k: v for k, v in own.effects.items() if k != "contact"}
    assert compare_runs(small_scene(), replace(own, effects=without), own).contact_rms is None


def test_runs_that_are_lost_say_why(own):
    assert why_incomparable(own, own) is None
    flags = own.flags.copy()
    flags[-1] |= int(Status.NOT_FINITE)
    assert why_incomparable(replace(own, flags=flags), own) == "does not stay finite"
    assert why_incomparable(replace(own, position=own.position + 0.2), own) == "the patella flies off"
    nowhere = replace(own.equilibrium, residual=1.0)
    assert why_incomparable(replace(own, equilibrium=nowhere), own) == "no equilibrium to start from"


def test_a_run_without_an_equilibrium_is_not_lost_from_the_table(own):
    """Only weight: nothing holds the patella, and the run says so itself."""
    falling = small_scene().without("contact").without("quadriceps").without("patellar_tendon")
    result = run_alone(falling, LinearImplicit(), SUBSTEPS).result
    assert why_incomparable(result, own) == "no equilibrium to start from"


def test_outcomes_are_what_is_new(own):
    flags = own.flags | int(Status.STEP_TOO_LONG)
    assert _outcome(own, own) == ""
    assert "too far within one step" in _outcome(replace(own, flags=flags), own)
    aside = replace(own, center=own.center + np.array([0, 1.2 * RADIUS, 0]))
    assert "dislocates" in _outcome(aside, own)


@pytest.mark.parametrize(("kind", "yes", "no"), [("left out", "worth keeping", "can be left out"),
                                                 ("added", "worth adding", "not needed")])  # fmt: skip
def test_verdicts_go_by_the_tolerance_and_by_dislocation(own, kind, yes, no):
    moved = compare_runs(small_scene(), replace(own, position=own.position + np.array([2e-4, 0, 0])), own)
    assert _verdict(kind, moved, "", 1e-4) == yes
    assert _verdict(kind, moved, "", 3e-4) == no
    assert _verdict(kind, moved, "dislocates", 3e-4) == yes


def test_an_effect_with_which_nothing_runs_cannot_be_judged():
    broken = "does not stay finite"
    said = [_verdict(kind, None, broken, 1e-4) for kind in ("left out", "added", "changed", "yardstick")]
    assert said == ["indispensable", *["cannot be judged"] * 3]


@pytest.mark.slow
def test_side_by_side_is_as_alone():
    base = knee(FRAMES)
    heavier = eqx.tree_at(lambda s: s.patella.mass, base, 2 * base.patella.mass)
    softer = eqx.tree_at(lambda s: s.effects[1].stiffness, base, 0.9 * base.effects[1].stiffness)
    variants = [Variant(n, "changed", "", s, alike=True) for n, s in (("heavier", heavier), ("softer", softer))]
    together = run_side_by_side(variants, LinearImplicit(), SUBSTEPS)
    for run, one in zip(together, (heavier, softer), strict=True):
        alone = run_alone(one, LinearImplicit(), SUBSTEPS).result
        np.testing.assert_allclose(run.result.center, alone.center, atol=1e-9)
        assert run.rerun is None
    assert np.abs(together[0].result.center - together[1].result.center).max() > 1e-5


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan")])
def test_a_tolerance_is_positive(tolerance):
    with pytest.raises(InputError, match="positive"):
        audit(scene(), tolerance=tolerance)


def test_tables_have_units_and_all_rows(found):
    data = dataset(found)
    assert data.sizes == {"variant": len(found.rows)}
    assert data.path_max_mm.attrs["units"] == "mm"
    assert float(data.path_rms_mm.sel(variant="gravity")) == pytest.approx(
        1e3 * row(found, "gravity").changes.center_rms
    )
    assert all(len(c.values) == len(found.rows) for c in columns(found))
    assert gravity().name in data.coords["variant"]


def test_a_note_says_what_the_steps_leave_of_restitution(found):
    """Nothing touches in this scene: see the rig's case below for one that has a contact."""
    assert found.impact == ""
    assert not [note for note in audit_sheet(found).notes if "restitution" in note]
    said = Impact(0.24, 0.01, 0.47, 0.06, 1e-3).describe()
    assert f"restitution: {said}" in audit_sheet(replace(found, impact=said)).notes


def test_the_figure_names_every_variant(found):
    figure = audit_figure(found, "title")
    shown = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert shown == [r.name for r in found.rows]
    assert len(figure.axes) == 3


@pytest.mark.parametrize("share", [-7.5, 12.34])
def test_shares_beyond_the_axis_are_written_where_nothing_cuts_them(found, share):
    """Such bars go on to the axis' end; the number stands right of zero, within the figure."""
    rows = tuple(replace(r, cost=share, spread=0.01) if r.name == "gravity" else r for r in found.rows)
    figure = audit_figure(replace(found, rows=rows, synthetic=True), "title")
    figure.draw_without_rendering()
    time = figure.axes[2]
    (number,) = (text for text in time.texts if "%" in text.get_text())
    assert number.get_text() == f"{100 * share:+,.0f} %".replace("-", "\N{MINUS SIGN}")
    box, panel = number.get_window_extent(), time.get_window_extent()
    assert panel.x0 < box.x0 < box.x1 <= figure.bbox.x1
    assert footers(figure)[0].get_text() == SYNTHETIC


def test_the_command_writes_everything(found, tmp_path, monkeypatch):
    made_up = replace(found, synthetic=True)
    monkeypatch.setattr("pftwin.studies.audit.audit.audit", lambda *_, **__: made_up)
    monkeypatch.setattr("pftwin.rig.case", lambda *_, **__: scene())
    folder = tmp_path / "new" / "audit"
    done = CliRunner().invoke(app, ["audit", "--case", "1", "--out", str(folder), "--json", str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in folder.iterdir()) == ["audit.csv", "audit.nc", "audit.png", "audit.svg"]
    with (folder / "audit.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [r["what"] for r in rows] == [r.name for r in found.rows]
    import xarray

    with xarray.open_dataset(folder / "audit.nc") as data:
        assert list(data.coords["variant"].values) == [r.name for r in found.rows]
    data = json.loads((tmp_path / "a.json").read_text())
    assert data["synthetic"] is True
    assert data["machine"]["load"]
    assert "synthetic" in done.output


@pytest.mark.slow
def test_only_the_rows_that_are_wanted(whole):
    """With the figures that they have among the others, and fewer programs."""
    some = audit(scene(), dt=0.01 / SUBSTEPS, only=("gravity", "steps half as long", "friction"))
    assert [r.name for r in some.rows] == ["gravity", "steps half as long"]
    assert [v.name for v in some.not_applicable] == ["friction"]
    for r in some.rows:
        assert r.changes.center_max == pytest.approx(row(whole, r.name).changes.center_max, rel=1e-9)
    assert some.programs == 1 + 2 + 3


@pytest.mark.parametrize("only", [["gravity", "wind"], "gravity"])
def test_rows_that_there_are_not_are_refused(only):
    with pytest.raises(InputError, match="steps half as long"):
        audit(scene(), only=only)


@pytest.mark.parametrize(
    "arguments", [["--tolerance", "0 mm"], ["--tolerance", "nan"], ["--tolerance", "1 N"], ["--out", __file__]]
)
def test_the_command_refuses_before_any_work(arguments):
    done = CliRunner().invoke(app, ["audit", "--case", "1", *arguments])
    assert done.exit_code == 2
    assert "error: " in done.stderr


@pytest.mark.slow
def test_the_rigs_case_is_audited():
    import pftwin

    found = audit(pftwin.rig.case(1))
    assert {r.name for r in found.rows if r.verdict == "indispensable"} == {"quadriceps", "patellar_tendon", "contact"}
    assert row(found, "moving-femur inertia").changes.center_max < 2e-3
    assert row(found, "friction").changes.center_max > 1e-3
    assert row(found, "steps half as long").verdict == "steps short enough"
    assert row(found, "contact").cost > 0.3
    assert found.impact.startswith("contacts close at 0.004")
    assert "too slow" in found.impact
