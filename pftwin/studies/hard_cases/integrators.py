"""The integrators that all cases run with. A new one is a line in `INTEGRATORS`."""

from __future__ import annotations

from typing import NamedTuple

from pftwin.studies.hard_cases.contacts import PATCHES


class CaseIntegrator(NamedTuple):
    """An integrator, and how it is used here."""

    name: str  # as `pftwin.dynamics.integrators` has it
    longest_step: float = 1.0  # that the matrix gives it [s]
    most_steps: int | None = None  # of a run: cases that need more are left out; None: no limit
    may_refuse: bool = False  # whether it may say that a step is too long for a case, where the case does not
    inertia: bool = True  # without: energy is the stored one alone, and equilibria that end are told by a flag
    only: tuple[str, ...] | None = None  # kinds of contact that it runs with; None: all
    float32: bool = True
    differentiated_on: tuple[str, ...] | None = None  # kinds of contact with which derivatives are looked at; None: all
    side_by_side: bool = True  # whether batches of it are looked at too


QUICK = (*PATCHES, "volume")  # derivatives on contours take tens of minutes but for the linearly implicit steps

INTEGRATORS = (
    CaseIntegrator("linear_implicit"),
    CaseIntegrator("linear_implicit_bdf2", may_refuse=True),  # not damped enough for impacts shorter than a step
    CaseIntegrator(
        "newmark", may_refuse=True, side_by_side=False, differentiated_on=QUICK
    ),  # a batch compiles for minutes
    CaseIntegrator("symplectic_euler", longest_step=1e-4, may_refuse=True, differentiated_on=QUICK),
    CaseIntegrator("diffrax:Tsit5", may_refuse=True, only=("P5",), float32=False),
    # By volume its derivatives were not there after 40 minutes, most of it compiling.
    CaseIntegrator("quasi_static", may_refuse=True, inertia=False, side_by_side=False, differentiated_on=PATCHES),
    # Some 0.3 ms a step, and so few steps; undamped, as Newmark's method.
    CaseIntegrator(
        "ali3p",
        most_steps=1000,
        may_refuse=True,
        only=("P5",),
        float32=False,
        differentiated_on=(),
        side_by_side=False,
    ),
)


def method_named(name: str) -> CaseIntegrator:
    """That of `INTEGRATORS`, or any other integrator as it comes."""
    return next((m for m in INTEGRATORS if m.name == name), CaseIntegrator(name))
