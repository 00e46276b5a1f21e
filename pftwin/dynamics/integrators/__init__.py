"""Ways to take one step, one file each. Each is a value with its options, and declares its order."""

from pftwin.dynamics.ali3p.step import ALI3P
from pftwin.dynamics.integrator import Diagnostics, Integrator
from pftwin.dynamics.integrators.bdf2 import BDF2
from pftwin.dynamics.integrators.diffrax_solver import Diffrax
from pftwin.dynamics.integrators.from_text import integrator_from_text
from pftwin.dynamics.integrators.linear_implicit import LinearImplicit
from pftwin.dynamics.integrators.newmark import Newmark
from pftwin.dynamics.integrators.symplectic_euler import SymplecticEuler
from pftwin.dynamics.quasi_static.step import QuasiStatic

__all__ = [
    "ALI3P",
    "BDF2",
    "Diagnostics",
    "Diffrax",
    "Integrator",
    "LinearImplicit",
    "Newmark",
    "QuasiStatic",
    "SymplecticEuler",
    "integrator_from_text",
]
