"""A differentiable digital twin of the patellofemoral joint in JAX.

    scene = pftwin.rig.case(2, contact="P5")  # or pftwin.load_scene("knee.toml")
    result = pftwin.simulate(scene)
    result.to_dataset(), result.save("case2.nc")

Names are imported on first use, so that `import pftwin` is fast and does not change JAX's settings. The first use of a
name that computes sets double precision and fast compilation; call `pftwin.configure()` before for other settings.
"""

from __future__ import annotations

from importlib import import_module
from time import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin import geometry as surfaces
    from pftwin import rig
    from pftwin.base.errors import InputError, OutputError, PftwinError
    from pftwin.base.runtime import configure
    from pftwin.dynamics.ali3p.step import ALI3P
    from pftwin.dynamics.batch.simulate_batch import simulate_batch
    from pftwin.dynamics.batch.variants import Variants
    from pftwin.dynamics.integrators import BDF2, Diffrax, Integrator, LinearImplicit, Newmark, SymplecticEuler
    from pftwin.dynamics.quasi_static.step import QuasiStatic
    from pftwin.dynamics.simulate import equilibrium, simulate
    from pftwin.dynamics.status import Status
    from pftwin.dynamics.trajectory import Trajectory, trajectory
    from pftwin.files import interchange, mocap
    from pftwin.files.scene_file import load_scene
    from pftwin.files.scene_file.registry import register_effect
    from pftwin.model import effects
    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene
    from pftwin.results import plots, viewer
    from pftwin.results.metrics import validate
    from pftwin.results.result import Result

    __version__: str

imported_at = time()  # [s] since the epoch; this process does not run source files that are newer

_HOME = {
    "InputError": "base.errors",
    "ALI3P": "dynamics.ali3p.step",
    "BDF2": "dynamics.integrators",
    "Diffrax": "dynamics.integrators",
    "Integrator": "dynamics.integrators",
    "LinearImplicit": "dynamics.integrators",
    "Measured": "model.measured",
    "Newmark": "dynamics.integrators",
    "QuasiStatic": "dynamics.quasi_static.step",
    "SymplecticEuler": "dynamics.integrators",
    "Trajectory": "dynamics.trajectory",
    "OutputError": "base.errors",
    "PftwinError": "base.errors",
    "Result": "results.result",
    "Scene": "model.scene",
    "Status": "dynamics.status",
    "Variants": "dynamics.batch.variants",
    "configure": "base.runtime",
    "equilibrium": "dynamics.simulate",
    "load_scene": "files.scene_file",
    "register_effect": "files.scene_file.registry",
    "simulate": "dynamics.simulate",
    "simulate_batch": "dynamics.batch.simulate_batch",
    "trajectory": "dynamics.trajectory",
    "validate": "results.metrics",
}
_NO_JAX = ("InputError", "Measured", "OutputError", "PftwinError", "configure")  # all others may compute
_PACKAGES = {
    "effects": "model.effects",
    "interchange": "files.interchange",
    "mocap": "files.mocap",
    "plots": "results.plots",
    "rig": "rig",
    "surfaces": "geometry",
    "viewer": "results.viewer",
}

__all__ = [
    "ALI3P",
    "BDF2",
    "Diffrax",
    "InputError",
    "Integrator",
    "LinearImplicit",
    "Measured",
    "Newmark",
    "OutputError",
    "PftwinError",
    "QuasiStatic",
    "Result",
    "Scene",
    "Status",
    "SymplecticEuler",
    "Trajectory",
    "Variants",
    "__version__",
    "configure",
    "effects",
    "equilibrium",
    "interchange",
    "load_scene",
    "mocap",
    "plots",
    "register_effect",
    "rig",
    "simulate",
    "simulate_batch",
    "surfaces",
    "trajectory",
    "validate",
    "viewer",
]


if not TYPE_CHECKING:  # so that type checkers report names that do not exist

    def __getattr__(name: str) -> Any:
        if name in __all__ and name not in _NO_JAX and name != "__version__":
            from pftwin.base.runtime import use_defaults

            use_defaults()
        if name == "__version__":
            value = _version()
        elif name in _HOME:
            value = getattr(import_module(f"pftwin.{_HOME[name]}"), name)
        elif name in _PACKAGES:
            value = import_module(f"pftwin.{_PACKAGES[name]}")
        else:
            raise AttributeError(f"module 'pftwin' has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("pftwin")
    except PackageNotFoundError:
        return "0+unknown"
