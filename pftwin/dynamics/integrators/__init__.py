"""Time integrators of one file each; `pftwin.dynamics.ali3p` and `pftwin.dynamics.quasi_static` are the others."""

from __future__ import annotations

from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators.bdf2 import BDF2
from pftwin.dynamics.integrators.diffrax_solver import Diffrax
from pftwin.dynamics.integrators.linear_implicit import LinearImplicit
from pftwin.dynamics.integrators.newmark import Newmark
from pftwin.dynamics.integrators.symplectic_euler import SymplecticEuler

__all__ = ["BDF2", "Diffrax", "Integrator", "LinearImplicit", "Newmark", "SymplecticEuler"]
