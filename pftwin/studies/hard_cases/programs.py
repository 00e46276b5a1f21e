"""The few programs that run all cases: one structure of scene, one compilation for each integrator and float type.

Cases follow one another in a loop inside the program (`jax.lax.map`): compiled like a single run, and no case waits for
the one with the shortest steps. That a batch side by side (`jax.vmap`) gives the same is one of the checks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import first_guide, frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.relaxation import relax
from pftwin.dynamics.state import State, System
from pftwin.dynamics.static_load import still
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.model.effects.contact import Contact
from pftwin.model.scene import Scene
from pftwin.studies.hard_cases.nearest import depth_everywhere

# Compiled without LLVM's optimisations, which takes a third of the time: the runs are short.
OPTIONS = {"xla_backend_optimization_level": 0}
PARAMETERS = ("quadriceps stiffness", "patellar tendon's slack length", "height of the surface", "contact stiffness")
UNITS = (1.0, 1e-2, 1e-3, 1.0)  # of the parameters' changes: relative, [m], [m], relative


class Rest(eqx.Module):
    """A scene's start."""

    equilibrium: Solution
    released: Solution  # where the scene puts the patella, not in equilibrium
    slopes: Array  # (7, 4) of the equilibrium's position and quaternion by `PARAMETERS`


class CaseRun(eqx.Module):
    """What came out of a run; leading axis: frames."""

    states: State
    seen: Observation
    ledger: Ledger


def varied(scene: Scene, p: Array) -> Scene:
    """The scene with its parameters changed by p (4,), in `UNITS`."""
    quadriceps, tendon, button = (scene.index(n) for n in ("quadriceps", "patellar_tendon", "contact"))
    scene = eqx.tree_at(
        lambda s: (
            s.effects[quadriceps].stiffness,
            s.effects[tendon].slack_length,
            s.effects[button].law.contact_stiffness,
        ),
        scene,
        (
            scene.effects[quadriceps].stiffness * (1 + UNITS[0] * p[0]),  # pyright: ignore
            scene.effects[tendon].slack_length + UNITS[1] * p[1],  # pyright: ignore
            scene.effects[button].law.contact_stiffness * (1 + UNITS[3] * p[3]),  # pyright: ignore
        ),
    )
    assert scene.contact is not None  # every case has one
    return scene.with_effect(_raised(scene.contact, UNITS[2] * p[2]))


def _raised(contact: Contact, by: Array) -> Contact:
    """The contact with its fitted surface raised; over a mesh the button is lowered instead."""
    surface: Any = contact.fitted_surface()
    if surface is None:
        return contact.with_button_moved(Vec3(jnp.zeros_like(by), jnp.zeros_like(by), -by))
    only = isinstance(surface, PolynomialPatch)  # the first coefficient is the height; a spline's add up to it
    change = by * jnp.eye(1, surface.coefficients.size)[0] if only else by  # pyright: ignore
    return contact.with_fitted_surface(eqx.tree_at(lambda s: s.coefficients, surface, surface.coefficients + change))


def poses(states: State) -> Array:
    """(..., 7): position [m] and quaternion."""
    return jnp.concatenate([states.position.array(), states.orientation.array()], axis=-1)


def _columns(function: Callable[[Array], Array]) -> Array:
    """Derivatives by p at nought, the parameters' axis last; one column after the other, compiled like one."""
    zero = jnp.zeros(len(PARAMETERS))
    columns = jax.lax.map(lambda d: jax.jvp(function, (zero,), (d,))[1], jnp.eye(len(PARAMETERS)))
    return jnp.moveaxis(columns, 0, -1)


def rest(scene: Scene, p: Array) -> Rest:
    """The scene's equilibrium with its derivatives, and its own start."""

    def found(change: Array) -> Array:
        pose = starting_equilibrium(varied(scene, p + change)).pose
        return jnp.concatenate([pose.position.array(), pose.orientation.array()])

    changed = varied(scene, p)
    pose, system = scene.center_of_mass_pose(), System.of(scene)
    solution = starting_equilibrium(changed)
    memories = system.remember(still(first_guide(scene), pose))
    unknown = jnp.full_like(solution.residual, jnp.inf)
    nothing = jnp.zeros_like(solution.residual)
    released = Solution(pose, memories, unknown, solution.iterations * 0, 0 * solution.stiffness, nothing)
    return Rest(solution, released, _columns(found))


def relaxed(scene: Scene) -> Pose:
    """Where the damped relaxation ends: a start for another search."""
    pose = relax(System.of(scene), first_guide(scene), scene.center_of_mass_pose())
    return Pose(pose.apply(-scene.patella.center_of_mass), pose.orientation)


def run(scene: Scene, start: Solution, substeps: Array, p: Array, integrator: Integrator) -> CaseRun:
    """A simulation with its ledger, and all that is looked at."""
    changed = varied(scene, p)
    path = frame_states(changed, integrator=integrator, substeps=substeps, start=start, ledger=True)
    assert path.ledger is not None
    return CaseRun(path.states, observe(changed, path), path.ledger)


def depths(scene: Scene, centers: Vec3) -> Array:
    """(n,): how deep the button is at places of its centre, by exhaustive search [m]."""
    button = System.of(scene).effects[scene.index("contact")].contact_role()
    assert button is not None
    return jax.lax.map(lambda c: depth_everywhere(button, c), centers)


def slopes(scene: Scene, start: Solution, substeps: Array, integrator: Integrator) -> Array:
    """(n, 7, 4): derivatives of the frames' poses by `PARAMETERS`, from a start that stays."""

    def path(p: Array) -> Array:
        return poses(frame_states(varied(scene, p), integrator=integrator, substeps=substeps, start=start).states)

    return _columns(path)


@lru_cache(maxsize=256)
def compiled(
    function: Callable[..., Any], float64: bool, side_by_side: bool = False, **fixed: str
) -> Callable[..., Any]:
    """A program over the leading axis of all arguments; one for each float type, whose settings have to be in force."""

    def each(*args: Any) -> Any:
        if side_by_side:
            return jax.vmap(lambda *one: function(*one, **fixed))(*args)
        return jax.lax.map(lambda one: function(*one, **fixed), args)

    return jax.jit(each, compiler_options=OPTIONS)
