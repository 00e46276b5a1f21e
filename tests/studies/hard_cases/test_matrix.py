"""Every case with every family of contacts: a sample of the matrix. `pftwin hard-cases` runs the whole."""

from __future__ import annotations

import math
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases import CONTACTS, DTYPES, INTEGRATORS, Selection, case_named, catalogue, method_named
from pftwin.studies.hard_cases.batch import steps_of
from pftwin.studies.hard_cases.case import HardCase
from pftwin.studies.hard_cases.contacts import MESHES
from pftwin.studies.hard_cases.matrix import run_matrix
from pftwin.studies.hard_cases.verdict import THOUGH_RIGHT

PAGE = Path(__file__).resolve().parents[3] / "docs" / "hard_cases.md"
Combination = tuple[str, str, str]  # contact, integrator, float type
FAMILIES: dict[str, tuple[Combination, ...]] = {  # the cases of a family take its combinations in turn
    "polynomials": (
        ("P5", "simulate", "float64"),
        ("P5", "linear_implicit", "float64"),
        ("P2", "linear_implicit_bdf2", "float32"),
        ("P4", "newmark", "float64"),
        ("P8", "symplectic_euler", "float64"),
        ("P5", "quasi_static", "float64"),
        ("P5", "ali3p", "float64"),
        # diffrax's explicit solver, which takes the longest, is left to the command.
    ),
    "over a cylinder": (
        ("P5 cylinder", "linear_implicit", "float32"),
        ("P5 cylinder", "linear_implicit_bdf2", "float64"),
    ),
    "spline": (("spline", "simulate", "float64"), ("spline", "linear_implicit_bdf2", "float32")),
    "contours": (("contours", "linear_implicit", "float64"), ("contours", "linear_implicit_bdf2", "float32")),
    "volume": (("volume", "linear_implicit_bdf2", "float64"), ("volume", "linear_implicit", "float32")),
}


@cache
def listed_cells() -> dict[tuple[str, str, str, str], str]:
    """By case, contact, integrator and float type: the outcomes that docs/hard_cases.md lists."""
    page, found = PAGE.read_text(encoding="utf-8"), {}
    for line in page[page.index("## Every cell") : page.index("## The cases")].splitlines():
        if line.startswith("| ") and not line.startswith(("| contact", "| ---")):
            contact, integrator, dtype, outcome, names = (x.strip() for x in line.strip("|").split("|"))
            found |= {(name, contact, integrator, dtype): outcome for name in names.split(", ")}
    return found


def sampled(family: str) -> dict[Combination, list[str]]:
    """The cases of each combination: every case that the family has, once."""
    found: dict[Combination, list[str]] = {c: [] for c in FAMILIES[family]}
    for k, case in enumerate(c for c in catalogue() if {f[0] for f in found} & set(c.contacts)):
        turn = (FAMILIES[family][(k + i) % len(found)] for i in range(len(found)))
        found[next(c for c in turn if _runs(case, c))].append(case.name)
    return found


def _runs(case: HardCase, combination: Combination) -> bool:
    """Whether the matrix has the cell; what takes few steps runs short cases alone."""
    method = method_named(combination[1])
    most = method.most_steps
    steps = 50 * steps_of(case, method) if case.group == "short" else math.inf
    return combination[0] in case.contacts and (most is None or steps <= most)


def test_the_page_lists_every_cell_that_it_counts():
    listed = Counter(listed_cells().values())
    counted = f"{listed.total()} cells: {listed['pass']} pass, {listed['fail']} fail, {listed['refused']} refused."
    assert counted in PAGE.read_text(encoding="utf-8")
    assert {name for name, *_ in listed_cells()} <= {c.name for c in catalogue()}


def test_the_sample_has_every_case_with_every_family_and_leaves_out_no_kind():
    chosen = {family: sampled(family) for family in FAMILIES}
    for contact in CONTACTS:
        (family,) = (f for f, combinations in FAMILIES.items() if contact in {c[0] for c in combinations})
        wanted = {c.name for c in catalogue() if contact in c.contacts}
        assert wanted <= {name for names in chosen[family].values() for name in names}
    combinations = [c for found in chosen.values() for c, names in found.items() if names]
    assert {c[1] for c in combinations} == {m.name for m in INTEGRATORS} - {"diffrax:Tsit5"}
    assert {c[2] for c in combinations} == set(DTYPES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "combination"),
    [(f, c) for f, combinations in FAMILIES.items() for c in combinations],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_nothing_fails_but_what_the_page_lists(family, combination):
    """On patches with derivatives and converged runs; on meshes these take too long."""
    contact, integrator, dtype = combination
    names = sampled(family)[combination]
    others = {case_named(n).expected.same_as for n in names} - {None, *names}  # that some have to move like
    cases = [c for c in catalogue() if c.name in {*names, *others}]
    smooth = contact not in MESHES
    chosen = Selection(
        (contact,), (method_named(integrator),), (dtype,), derivatives=smooth, batch_independence=smooth, truths=smooth
    )
    cells = {c.case: c for c in run_matrix(cases, chosen)}
    assert set(names) <= set(cells)
    failed = {n: cells[n].reason for n in names if cells[n].outcome == "fail"}
    assert {n for n in failed if listed_cells().get((n, *combination)) != "fail"} == set(), failed


@pytest.mark.slow
def test_all_cases_hold_on_a_patch_with_the_default_integrator():
    cases = [c for c in catalogue() if c.group == "short"]
    chosen = Selection(("P5",), (method_named("linear_implicit"),), ("float64",), batch_independence=False)
    cells = run_matrix(cases, chosen)
    assert {c.case: c.reason for c in cells if c.outcome == "fail"} == {}
    wrong_input = {c.name for c in catalogue() if c.expected.refusal is not None and "P5" in c.contacts}
    refused = {c.case: c.reason for c in cells if c.outcome == "refused" and c.case not in wrong_input}
    assert wrong_input <= {c.case for c in cells if c.outcome == "refused"}
    assert refused.pop("rebound_in_steps_of_5_ms").startswith(Status.ENERGY_FROM_NOWHERE.describe())
    said = Status.INACCURATE.describe(), Status.PEAK_UNKNOWN.describe()
    assert all(reason.startswith(said) for reason in refused.values())
    too_careful = {name for name, reason in refused.items() if reason.endswith(THOUGH_RIGHT)}
    assert too_careful == {"stiffness_times_100_in_5_ms"}  # the estimated error of a step is a bound
