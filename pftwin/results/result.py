"""The result of a simulation: motion, forces, energies and status flags as NumPy arrays on the host."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.leaves import host_array
from pftwin.base.rotations import (
    PatellarAngles,
    TibiofemoralAngles,
    continuous_signs,
    patellar_angles,
    tibiofemoral_angles,
)
from pftwin.base.spatial import Quaternion
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.equilibrium_report import (
    EquilibriumReport,
    invalid_start,
    largest_indentation,
    on_host,
    start_overlap,
)
from pftwin.dynamics.error_estimate import ErrorEstimate
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation
from pftwin.dynamics.rebound import Impact
from pftwin.dynamics.status import FLAGS, Status
from pftwin.model.effects.base import Observable
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import tibia_orientation, tibia_position
from pftwin.model.scene import Scene
from pftwin.results.tracking import DISLOCATED, Tracking, find_dislocations, groove_offset
from pftwin.results.verdict import REMARKS, Verdict, verdict_of

if TYPE_CHECKING:
    from k3d.plot import Plot
    from xarray import Dataset

    from pftwin.geometry.patch.closest import Surface
    from pftwin.results.plots import ResultPlots


@dataclass(frozen=True)
class Energies:
    """The energy budget over the frames, (n,) each [J]; see `pftwin.dynamics.ledger`.

    Work, heat and numerical dissipation are None if the simulation kept no energy account.
    """

    kinetic: Floats
    stored: dict[str, Floats]  # by effect
    work: Floats | None  # done by bodies with prescribed motion and by prescribed pulls since the start
    heat: Floats | None  # dissipated by damping since the start
    numerical_dissipation: Floats | None  # removed by the time integration since the start; negative: added

    @property
    def total(self) -> Floats:
        """Kinetic plus stored energy (n,) [J]."""
        return self.kinetic + sum(self.stored.values(), start=np.zeros_like(self.kinetic))

    @property
    def budget_error(self) -> Floats | None:
        """Residual of the energy balance (n,) [J], of second order in the step; None without an energy account."""
        if self.work is None or self.heat is None or self.numerical_dissipation is None:
            return None
        return self.total - self.total[0] - self.work + self.heat + self.numerical_dissipation


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The patella's motion and forces at the n recorded frames; the first axis of every array is the frame."""

    scene_name: str
    times: Floats  # (n,) [s]
    center: Floats  # (n, 3) centre of the button's sphere in the femur frame [m]
    position: Floats  # (n, 3) origin of the patella in the femur frame [m]
    quaternion: Floats  # (n, 4) patella to femur, scalar first, continuous in sign
    motion: KneeMotion  # prescribed motion of femur and tibia
    effects: dict[str, dict[str, NDArray[Any]]]  # values by effect and observable
    observables: dict[str, dict[str, Observable]]  # units and long names by effect and observable
    groups: dict[str, int]  # number of elements of each effect that is a group of equal elements
    energies: Energies
    flags: NDArray[np.int32]  # (n,) bits of `Status`
    equilibrium: EquilibriumReport
    contact: str | None  # name of the contact whose button is tracked
    surface: Surface | None  # trochlear surface of that contact
    settings: dict[str, Any]
    timing: dict[str, float]  # [s]
    dtype: str  # floating-point type of the simulation
    scene: Scene = field(repr=False)  # the simulated scene; `pftwin.results.scene_geometry` lists what a file stores
    constraint_drift: float | None = None  # largest constraint violation [m]; None without constraints
    error: ErrorEstimate | None = None  # estimated time-integration error; None if no error estimate was run
    impact: Impact | None = None  # hardest approach and its rebound; None without a contact law or energy account

    @classmethod
    def build(
        cls,
        scene: Scene,
        start: Solution,
        seen: Observation,
        ledger: Ledger | None,
        *,
        relaxed: bool,
        settings: dict[str, Any],
        timing: dict[str, float],
        error: ErrorEstimate | None = None,
        impact: Impact | None = None,
    ) -> Result:
        """Builds the result from the output of the compiled program for one scene.

        Args:
            scene, start, seen, ledger: simulated scene, starting equilibrium, observation and energy account.
            relaxed: whether damped relaxation was needed to find the starting equilibrium.
            settings, timing: "integrator", "dt_s", "substeps"; "equilibrium_s", "run_s" (of the chosen run, beside
                which another may have run), "estimate_s" (additional time of other runs), "compile_s".
            error, impact: see the fields; frames with a large error are flagged.
        """
        seen, ledger, start = on_host((seen, ledger, start))
        first = jax.tree.map(lambda a: a[0], (seen.patella, seen.effects, seen.status))
        contact, lines = scene.contact, [e.line_element() for e in scene.effects]
        kinetic, account = _double(seen.kinetic_energy), (None, None, None)
        if ledger is not None:
            taken = ledger.numerical_dissipation(seen.kinetic_energy)
            account = _double(ledger.work), _double(ledger.heat), _double(taken)
        stored = {name: _double(energy) for name, energy in seen.potential_energy.items()}
        return cls(
            scene_name=scene.name,
            times=scene.motion.times,
            center=host_array(seen.center),
            position=host_array(seen.patella.position),
            quaternion=continuous_signs(host_array(seen.patella.orientation)),
            motion=scene.motion,
            effects={n: {k: _double(v) for k, v in report.items()} for n, report in seen.effects.items()},
            observables={e.name: dict(type(e).observables) for e in scene.effects},
            groups={line.name: line.count for line in lines if line is not None and line.count is not None},
            energies=Energies(kinetic, stored, *account),
            flags=np.asarray(seen.status, dtype=np.int32) | (0 if error is None else error.flags),
            equilibrium=EquilibriumReport.build(scene, start, relaxed, there=first),
            contact=None if contact is None else contact.name,
            surface=None if contact is None else contact.groove_surface(),
            settings=dict(settings),
            timing=dict(timing),
            dtype=str(seen.center.x.dtype),
            scene=scene,
            constraint_drift=None if seen.drift is None else float(np.max(seen.drift)),
            error=error,
            impact=impact,
        )

    @cached_property
    def angles(self) -> PatellarAngles:
        """Flexion, rotation (internal positive) and tilt (lateral positive) of the patella in the femur, (n,) [rad]."""
        return patellar_angles(Quaternion(*self.quaternion.T))

    @cached_property
    def knee(self) -> TibiofemoralAngles:
        """Angles of the tibia in the femur at the recorded frames, (n,) each [rad]."""
        return tibiofemoral_angles(tibia_orientation(self.motion))

    @cached_property
    def tibia(self) -> tuple[Floats, Floats]:
        """Pose of the tibia in the femur frame: position (n, 3) [m] and quaternion (n, 4), continuous in sign."""
        return tibia_position(self.motion), continuous_signs(host_array(tibia_orientation(self.motion)))

    @property
    def poses(self) -> dict[str, tuple[Floats, Floats]]:
        """Positions (n, 3) [m] and quaternions (n, 4) of "patella" and "tibia" in the femur frame."""
        return {"patella": (self.position, self.quaternion), "tibia": self.tibia}

    @property
    def shift(self) -> Floats:
        """Medial-lateral position of the button's centre in the femur frame, lateral positive, (n,) [m]."""
        return self.center[:, 1]

    @property
    def contact_force(self) -> Floats:
        """Contact force on the patella in femur axes (n, 3) [N]; zero in a scene without a contact."""
        return np.stack([self._of_contact(f"force_{axis}") for axis in "xyz"], axis=1)

    @property
    def contact_force_medial(self) -> Floats:
        """Magnitude of the normal force on the medial facet (n,) [N]; zero in a scene without a contact."""
        return self._of_contact("force_medial")

    @property
    def contact_force_lateral(self) -> Floats:
        """Magnitude of the normal force on the lateral facet (n,) [N]; zero in a scene without a contact."""
        return self._of_contact("force_lateral")

    def _of_contact(self, name: str) -> Floats:
        return np.zeros(self.times.size) if self.contact is None else self.effects[self.contact][name]

    @property
    def tensions(self) -> dict[str, Floats]:
        """Tensions of tendons, strands and muscles by name, (n,) [N]; summed over the elements of a group."""
        return {n: t.reshape(self.times.size, -1).sum(axis=1) for n, t in self._of_lines("tension").items()}

    @property
    def lengths(self) -> dict[str, Floats]:
        """Lengths of the lines of force that report one, by name, (n,) or (n, lines) [m]."""
        return self._of_lines("length")

    def _of_lines(self, name: str) -> dict[str, Floats]:
        lines = [e.name for e in self.scene.effects if e.line_element() is not None]
        return {n: self.effects[n][name] for n in lines if name in self.effects[n]}

    @property
    def status(self) -> Status:
        """Union of the status flags of all frames."""
        return Status(int(np.bitwise_or.reduce(self.flags, initial=0)))

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the motion is valid, with the reasons if it is not."""
        return verdict_of(self.flags, invalid_start(self.scene, self.equilibrium))

    @cached_property
    def start_overlap(self) -> str:
        """Remark on an overlap of meshes at the recorded start; empty if there is none, or if `verdict` names it."""
        found = start_overlap(self.scene)
        return "" if found in self.verdict.reasons else found

    @property
    def tracking(self) -> str:
        """Description of the patella's tracking and dislocations; "INVALID" with the reasons if it is not valid."""
        if not self.verdict.valid:
            return self.verdict.describe()
        outcome = self.dislocations()
        return "not assessed: no contact surface" if outcome is None else outcome.describe()

    @property
    def duration(self) -> float:
        """Duration of the recorded motion [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def real_time_factor(self) -> float:
        """Duration of the motion over run time, without the search for the equilibrium; NaN if not timed."""
        run = self.timing.get("run_s", float("nan"))
        return self.duration / run if run > 0 else float("nan")

    @property
    def largest_indentation(self) -> float:
        """Largest penetration over all frames and contacts [m]; 0 if nothing touches, NaN without a contact."""
        return largest_indentation(self.effects)

    @cached_property
    def groove(self) -> tuple[Floats, Floats] | None:
        """Position along the groove and lateral distance from its bottom, (n,) each [m]; None without a surface."""
        return None if self.surface is None else groove_offset(self.surface, self.center)

    def dislocations(self, threshold: float = DISLOCATED) -> Tracking | None:
        """Finds when the button left the groove (farther than `threshold` [m] from its bottom) and re-engaged.

        Returns None in a scene without a contact surface and for a motion that is not valid (`verdict`).
        """
        if self.groove is None or not self.verdict.valid:
            return None
        return find_dislocations(self.times, self.groove[1], self.knee.flexion, threshold=threshold)

    def __repr__(self) -> str:
        return f"Result({self._facts()[0]})\n  " + "\n  ".join(self._facts()[1:])

    def _repr_html_(self) -> str:
        """The summary as an HTML table, for notebooks."""
        head, *facts = self._facts()
        rows = (fact.partition(": ") for fact in facts)
        cells = "".join(f"<tr><td>{escape(a)}</td><td>{escape(b)}</td></tr>" for a, _, b in rows)
        return f"<table><caption>{escape(head)}</caption>{cells}</table>"

    def summary(self) -> str:
        """Returns the main results in a few lines of text."""
        return "\n".join(self._facts())

    def _facts(self) -> list[str]:
        """The lines of the summary; the first is the heading."""
        counts = [(f, int(np.count_nonzero(self.flags & f))) for f in FLAGS]
        said = {f: f"{n} of {self.times.size} frames: {f.describe()}" for f, n in counts if n}
        remarks = [f"remark: {words}" for f, words in said.items() if f in REMARKS]
        if self.impact is not None and self.impact.unresolved:
            remarks.append(f"remark: restitution: {self.impact.describe()}")
        remarks += [f"remark: {self.start_overlap}"] if self.start_overlap else []
        elsewhere = REMARKS | self.verdict.flags  # at the end, and in the first line
        marks = [f"status: {words}" for f, words in said.items() if f not in elsewhere]
        lines = [f"{self.scene_name}: {self.times.size} frames, {self.duration:.2f} s"]
        lines.append(f"start: {self.equilibrium.description}")
        if not self.verdict.valid:
            lines.insert(0, self.verdict.describe())
        elif self.surface is not None:
            lines.append(f"tracking: {self.tracking}")
        lines += marks
        lines += ["status: all frames clean"] if self.verdict.valid and not said else []
        if self.largest_indentation > 0:
            lines.append(f"largest indentation: {1e3 * self.largest_indentation:.3f} mm")
        if self.error is not None:
            lines.append(f"estimated error, at most: {self.error.describe()}")
        if self.constraint_drift is not None:
            lines.append(f"largest constraint drift: {self.constraint_drift:.2g} m")
        if np.isfinite(self.real_time_factor):
            lines.append(f"{self.real_time_factor:.3g} x real time")
        return lines + remarks

    def to_dataset(self) -> Dataset:
        """Returns the result as an xarray Dataset with a unit and a long name on every variable."""
        from pftwin.results.result_dataset import dataset

        return dataset(self)

    def geometry(self) -> Dataset:
        """Returns the scene's drawable geometry: surfaces, lines of force, button (`pftwin.results.scene_geometry`)."""
        from pftwin.results.scene_geometry import geometry

        return geometry(self.scene, self.effects, self.poses)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a NetCDF file with a group `geometry`, atomically. Raises OutputError if the path is not writable."""
        from pftwin.files.result_files import GEOMETRY, save_dataset

        save_dataset(self.to_dataset(), path, groups={GEOMETRY: self.geometry()})

    @property
    def plot(self) -> ResultPlots:
        """Figures: `result.plot.trajectory().savefig("path.pdf")`; see `pftwin.plots`."""
        from pftwin.results.plots import ResultPlots

        return ResultPlots(self)

    def view(self, html: str | os.PathLike[str] | None = None) -> Plot:
        """Shows the knee in 3D as a notebook widget and, with `html`, as a page that opens offline.

        Raises:
            MissingExtraError: the extra `viewer` is not installed.
            OutputError: the page cannot be written.
        """
        from pftwin.results.viewer import view

        return view(self, html)

    def to_csv(self, path: str | os.PathLike[str], axes: str = "pftwin") -> None:
        """Writes a CSV table with units in its header, in the axes of pftwin or the ISB ("isb").

        Raises InputError for other axes, OutputError if the path is not writable.
        """
        from pftwin.files.result_files import save_csv

        save_csv(self.to_dataset(), path, axes)

    def to_sto(self, path: str | os.PathLike[str], axes: str = "pftwin") -> None:
        """Writes an OpenSim storage file, angles in degrees; `axes` and errors as in `to_csv`."""
        from pftwin.files.result_files import save_sto

        save_sto(self.to_dataset(), path, axes)


def _double(values: Any) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
