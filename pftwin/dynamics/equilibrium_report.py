"""Report on a static equilibrium: convergence, stability, loaded facets, and observables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.leaves import host_array
from pftwin.base.program_cache import Program
from pftwin.base.spatial import Pose, Scalar
from pftwin.dynamics.equilibrium import Solution, tolerance_on_host
from pftwin.dynamics.frame_states import at_start, first_guide
from pftwin.dynamics.observe import instant_and_frame
from pftwin.dynamics.state import System
from pftwin.dynamics.static_load import LEVER, patella_at_rest
from pftwin.dynamics.status import RESERVATIONS, Status, status_facts, status_of_lines
from pftwin.model.limits import not_pulled
from pftwin.model.scene import Scene

_NEUTRAL = 1e-6  # fraction of the largest eigenvalue below which a direction counts as neutral
_OVERLAP = 1e-3  # indentation at the recorded start above which it is named; loads in extension give less [m]
Reports = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class EquilibriumReport:
    """A static equilibrium of the patella at the first frame.

    Eigenvalues are the real parts, ascending, of those of the tangent stiffness with respect to displacements and to
    rotations times a lever of 20 mm.
    """

    position: NDArray[np.float64]  # (3,) of the patella's origin in the femur [m]
    quaternion: NDArray[np.float64]  # (4,) patella to femur, scalar first
    residual: float  # norm of force and moment / lever [N]
    tolerance: float  # [N]
    iterations: int
    relaxed: bool  # whether it was found by damped relaxation
    eigenvalues: NDArray[np.float64]  # (6,) [N/m]
    facets: tuple[str, ...]  # the loaded ones of "medial", "lateral"
    moved: float  # displacement of the centre of mass from the scene's start pose [m]
    turned: float  # rotation from the scene's start pose [rad]
    effects: dict[str, dict[str, NDArray[np.float64]]]  # observables; for the start of a run, with moving bodies
    lines: Status  # flags from lines of force

    @staticmethod
    def build(
        scene: Scene, solution: Solution, relaxed: bool, *, there: tuple[Pose, Reports, Any] | None = None
    ) -> EquilibriumReport:
        """Builds the report on a solution, which need not have converged: see `converged` and `description`.

        `there` contains the patella's pose in the femur, observables and the frame's status; computed by default.
        """
        there = _observe_at(at_start(scene.unnamed()), solution.pose) if there is None else there
        pose, reports, status = on_host(there)
        # Plain NumPy from here on, so that JAX does not compile programs for a few numbers.
        solution, guess, com = on_host((solution, scene.start, scene.patella.center_of_mass))
        turn = host_array(guess.orientation)
        start = host_array(guess.position) + _turned(turn, host_array(com))
        cosine = abs(float(np.dot(host_array(solution.pose.orientation), turn)))
        return EquilibriumReport(
            position=host_array(pose.position),
            quaternion=host_array(pose.orientation),
            residual=float(solution.residual),
            tolerance=float(tolerance_on_host(solution)),
            iterations=int(solution.iterations),
            relaxed=bool(relaxed),
            eigenvalues=_eigenvalues(np.asarray(solution.stiffness, dtype=np.float64)),
            facets=_loaded_facets(reports),
            moved=float(np.linalg.norm(host_array(solution.pose.position) - start)),
            turned=2 * float(np.arccos(min(1.0, cosine))),
            effects={
                name: {key: np.asarray(value, dtype=np.float64) for key, value in report.items()}
                for name, report in reports.items()
            },
            lines=Status(int(status)) & Status.END_WITHIN_WRAP,
        )

    @property
    def converged(self) -> bool:
        """Whether the residual is below the tolerance."""
        return self.residual < self.tolerance

    @property
    def kind(self) -> str:
        """Stable, neutral (no stiffness in some direction), saddle (unstable in some direction), or unknown."""
        least, most = self.eigenvalues[0], np.abs(self.eigenvalues).max()
        if not np.isfinite(least):
            return "unknown"
        if abs(least) <= _NEUTRAL * most:
            return "neutral"
        return "stable" if least > 0 else "saddle"

    @property
    def status(self) -> Status:
        """Flags from the effects: too deep, beyond the patch, overflow of a search, or a line's end in its obstacle."""
        found = self.lines
        for report in self.effects.values():
            for name, flag in RESERVATIONS.items():
                if np.any(report.get(name, np.zeros(())) > 0):
                    found |= flag
        return found

    @property
    def description(self) -> str:
        """Description of the equilibrium in one sentence."""
        if not self.converged:
            why = f"; {self.status.describe()}" if self.status else ""
            return (
                f"no equilibrium: the residual force is {self.residual:.3g} N after {self.iterations} iterations{why}"
            )
        place = {0: "free of contact", 1: f"on the {' '.join(self.facets)} facet alone"}
        where = place.get(len(self.facets), "on the medial and the lateral facet at once")
        helped = ", found by damped relaxation" if self.relaxed else ""
        helped += f"; {self.status.describe()}" if self.status else ""
        return (
            f"{self.kind} equilibrium {where}, {1e3 * self.moved:.2f} mm and {np.degrees(self.turned):.2f} deg "
            f"from the start pose{helped}"
        )

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values, for JSON."""
        return {
            "position_m": self.position.tolist(),
            "quaternion": self.quaternion.tolist(),
            "residual_N": self.residual,
            "converged": self.converged,
            **status_facts([self.status]),
            "iterations": self.iterations,
            "relaxed": self.relaxed,
            "kind": self.kind,
            "eigenvalues_N_per_m": self.eigenvalues.tolist(),
            "lever_m": LEVER,
            "facets": list(self.facets),
            "moved_m": self.moved,
            "turned_rad": self.turned,
            "description": self.description,
            "effects": {n: {k: v.tolist() for k, v in r.items()} for n, r in self.effects.items()},
        }


@Program
def _observe_at(scene: Scene, pose: Pose) -> tuple[Pose, dict[str, dict[str, Any]], Any]:
    """Pose in the femur, observables and flags of lines, of a patella at rest at a pose of its centre of mass."""
    system, guide = System.of(scene), first_guide(scene)
    now = patella_at_rest(guide, pose)
    memories = system.remember(now)
    reports = {e.name: e.observe(now, m) for e, m in zip(system.effects, memories, strict=True)}
    frame = instant_and_frame(scene, system.at_rest(pose, memories), guide)[1]
    return frame, reports, status_of_lines(system, now)


def on_host(tree: Any) -> Any:
    """The pytree with NumPy arrays."""
    if jax.default_backend() != "cpu":
        return jax.device_get(tree)  # fetches all arrays concurrently
    return jax.tree.map(np.asarray, tree)  # shares the memory, in a fifth of the time


def _turned(q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """A vector (3,) rotated by a unit quaternion (4,)."""
    (w, x, y, z), (a, b, c) = q, v
    t = np.array([y * c - z * b, z * a - x * c, x * b - y * a])  # q x v
    return v + 2 * (w * t + np.array([y * t[2] - z * t[1], z * t[0] - x * t[2], x * t[1] - y * t[0]]))


class Start(NamedTuple):
    """What `invalid_start` judges of an equilibrium; of members of a batch, which have no report, arrays (n,)."""

    converged: Any
    moved: Any  # displacement of the centre of mass from the scene's start pose [m]
    turned: Any  # rotation from the scene's start pose [rad]


def start_offset(scene: Scene, found: Solution) -> tuple[Scalar, Scalar]:
    """`moved` [m] and `turned` [rad] as in an `EquilibriumReport`, of a traced scene."""
    start = scene.center_of_mass_pose()
    cosine = jnp.abs(jnp.sum(found.pose.orientation.array() * start.orientation.array()))
    return (found.pose.position - start.position).norm(), 2 * jnp.arccos(jnp.minimum(1.0, cosine))


def invalid_start(scene: Scene, start: EquilibriumReport | Start, *, explained: bool = True) -> tuple[str, ...]:
    """Reasons not to trust any motion of a scene with limits: fewer lines than `least_upward_lines` pull the patella
    upward at the start, or the equilibrium is far from the recorded start. A failed search has its own status flag.

    `explained`: also name an overlap at the recorded start, which is simulated; not for each of many draws.
    """
    limits = scene.limits
    if limits is None or not start.converged:
        return not_pulled(scene)
    shift, turn = 1e3 * start.moved, float(np.degrees(start.turned))
    pairs = ((shift, "mm", "most_start_shift_mm"), (turn, "deg", "most_start_turn_deg"))
    far = [
        f"the equilibrium is {found:.1f} {unit} from the recorded start (at most {getattr(limits, name):g}: {name})"
        for found, unit, name in pairs
        if found > getattr(limits, name)
    ]
    return (*not_pulled(scene), *far, *(_overlap_at_start(scene) if far and explained else ()))


def start_overlap(scene: Scene) -> str:
    """Names meshes that overlap by more than 1 mm where the patella was recorded; empty if they do not.

    A motion starts from an equilibrium, so this is no reason against one from an equilibrium near by; but the recorded
    pose and the meshes do not belong together. Empty for patches, which may differ as much from the femur that they
    are fitted to, and for scenes without limits.
    """
    on_meshes = scene.contact is not None and scene.contact.method != ""
    return "".join(_overlap_at_start(scene)) if on_meshes and scene.limits is not None else ""


def largest_indentation(reports: Reports) -> float:
    """Largest penetration among effects' observables [m]; 0 if nothing touches, NaN without a finite depth."""
    depths = [np.asarray(v) for r in reports.values() for key, v in r.items() if key.startswith("indentation")]
    finite = [d[np.isfinite(d)] for d in depths]
    return max((float(d.max(initial=0.0)) for d in finite if d.size), default=float("nan"))


def _overlap_at_start(scene: Scene) -> tuple[str, ...]:
    """A message if a contact is deeper than `_OVERLAP` where the patella was recorded, or too deep to be found."""
    reports = on_host(_observe_at(at_start(scene.unnamed()), scene.center_of_mass_pose())[1])
    deepest = largest_indentation(reports)
    if deepest > _OVERLAP:
        depth = f"{1e3 * deepest:.1f} mm"
    elif any(np.any(report.get("too_deep", 0.0) > 0) for report in reports.values()):
        depth = "more than the contact search can measure"
    else:
        return ()
    return (f"the surfaces in contact overlap by {depth} at the recorded start",)


def _eigenvalues(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(stiffness).all():
        return np.full(6, np.nan)
    found = np.linalg.eigvals(stiffness).real  # complex only where forces have no potential
    return np.sort(np.asarray(found, dtype=np.float64))


def _loaded_facets(reports: Reports) -> tuple[str, ...]:
    return tuple(
        side for side in ("medial", "lateral") if any(np.any(r.get(f"force_{side}", 0.0) > 0) for r in reports.values())
    )
