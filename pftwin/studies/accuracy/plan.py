"""What is measured: which contact models, integrators, float types and numbers of steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pftwin.base.errors import InputError
from pftwin.dynamics.integrators import integrator_from_text

SUBSTEPS = (1, 2, 5, 10, 20, 50)  # of 10 ms frames: 10 to 0.2 ms
SHORT = (10, 20, 50, 100, 200)  # explicit steps are unstable in contact above 0.4 ms
ADAPTIVE = (1, 2, 10)  # the solver chooses its own steps within these
REFERENCE = 256  # substeps of the converged run
ON_MESHES = (1, 2, 5, 10, 20)  # 0.5 ms: what the meshes' facets cost is more than shorter steps gain
REFERENCE_ON_MESHES = 100
CYLINDER = "-cylinder"  # of a patch's name: over a cylinder instead of a plane
SMOOTH = ("P2", "P4", "P5", "P5-cylinder", "P8", "spline")
MESHES = ("CM", "FM", "volume")
COMMON = ("linear_implicit", "linear_implicit_bdf2", "newmark", "quasi_static")
FURTHER = ("symplectic_euler", "diffrax:Tsit5")
PAPERS = "ali3p"  # some hundred times slower than the rest: on P5 and on the coarse mesh
LONG = (1, 2, 5, 10)  # its steps, 1 ms as in the paper among them
FLOATS = ("float64", "float32")


class MeasuredProgram(NamedTuple):
    """One program to measure: everything but the step."""

    contact: str
    integrator: str
    dtype: str
    batch: bool  # whether many variants side by side are measured too
    gradient: bool  # and derivatives

    @property
    def substeps(self) -> tuple[int, ...]:
        """Numbers of steps between two frames."""
        name = self.integrator
        if name.startswith("diffrax"):
            return ADAPTIVE
        steps = ON_MESHES if self.contact in MESHES else SUBSTEPS
        return {"symplectic_euler": SHORT, PAPERS: LONG}.get(name, steps)


def chosen(contacts: Sequence[str], integrators: Sequence[str], floats: Sequence[str]) -> list[MeasuredProgram]:
    """Everything with everything, batches and derivatives included.

    Raises:
        InputError: an unknown integrator or float type.
    """
    for name in integrators:
        integrator_from_text(name)
    for name in floats:
        if name not in FLOATS:
            raise InputError(f"no float type {name!r}", where="--dtype", expected=f"one of: {', '.join(FLOATS)}")
    return [MeasuredProgram(c, i, d, True, True) for c in contacts for i in integrators for d in floats]


def everything() -> list[MeasuredProgram]:
    """The whole table. Single precision on P5; batches and derivatives for the steps that batches are for, and of every
    integrator on P5.
    """
    stepping, found = COMMON[:2], []
    for contact in (*SMOOTH, *MESHES):
        smooth, chief = contact in SMOOTH, contact == "P5"
        # Contours' forces jump from facet to facet: `quasi_static` refuses them. By volume it takes minutes.
        for integrator in (*COMMON, *FURTHER) if smooth else COMMON[:3]:
            more = smooth and (chief or integrator in stepping)
            found.append(MeasuredProgram(contact, integrator, "float64", more, more))
        if chief:
            found += [
                MeasuredProgram(contact, integrator, "float32", integrator in stepping, False) for integrator in COMMON
            ]
        if contact in ("P5", "CM"):
            found.append(MeasuredProgram(contact, PAPERS, "float64", False, False))
    return found
