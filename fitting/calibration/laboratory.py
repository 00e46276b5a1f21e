"""Records plants as a laboratory would: markers with noise, their filter, poses fitted to them; load cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from fitting.measured_channels import force_fields
from fitting.nuisance import OF_SENSORS
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap.filters import butterworth_lowpass
from pftwin.files.mocap.frames import cluster_poses
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.measured import Measured
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import poses
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from fitting.calibration.plants import PlantMotion


_CORNERS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / np.sqrt(3)


@dataclass(frozen=True)
class Laboratory:
    """How motion and forces are recorded; by default as on the virtual rig.

    Args:
        marker_noise: standard deviation of each coordinate of a marker [m].
        cluster: distance of each segment's four markers from its frame's origin [m].
        cutoff: of the markers' second-order Butterworth low-pass [Hz]; None: no filter.
        force_noise: standard deviation of a load cell's noise [N].
        force_bias: standard deviation of its zero error [N].
        force_scale: standard deviation of its scale error, as a share.
        time_shift: standard deviation of the delay of all forces against the markers [s].
        placement: standard deviation of each coordinate of the tracked point in the femur's frame, from registration of
            the femur to its markers [m].
        turn: standard deviation of the rotation of that frame about each axis, likewise [rad].
        readings: standard deviation of the noise of other observables that are recorded, by "EFFECT.OBSERVABLE". Zero
            errors, scale errors and delays apply only to forces that go by their effects' names.
    """

    marker_noise: float = 2e-4
    cluster: float = 0.05
    cutoff: float | None = 12.0
    force_noise: float = 0.15
    force_bias: float = 0.05
    force_scale: float = 0.0
    time_shift: float = 0.0
    placement: float = 0.0
    turn: float = 0.0
    readings: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own = {name: getattr(self, name) for name in ("marker_noise", "cluster", "force_noise", *OF_SENSORS)}
        for name, value in {**own, **self.readings}.items():
            if not (np.isfinite(value) and (value > 0 if name == "cluster" else value >= 0)):
                raise InputError(f"{name}: found {value!r}", where="laboratory", expected="a number, not negative")

    def recorded(
        self,
        scene: Scene,
        motion: PlantMotion,
        springs: Mapping[str, str],
        random: np.random.Generator,
        constant: np.random.Generator | None = None,
        *,
        first: bool = True,
    ) -> tuple[KneeMotion, Measured]:
        """Records a plant: its motion and measurements, from poses fitted to noisy markers.

        Args:
            scene: the plant's scene.
            motion: the plant's motion and forces.
            springs: names of the effects whose tensions are measured as "femoral" and "tibial" spring forces.
            random: of the noise.
            constant: of errors that are constant; by default a stream spawned from `random`. Copies of one generator
                make trials of one laboratory.
            first: whether it is the first of such trials; the others have their own time shift and load cells' zeros.

        Raises:
            InputError: a recording that is too short for the filter.
        """
        knee_motion, constant = scene.motion, constant or random.spawn(1)[0]
        times = np.asarray(knee_motion.frame_times())
        femur, tibia = (poses(part, times) for part in (knee_motion.femur, knee_motion.tibia))
        patella = PoseSeries(times, motion.position, motion.quaternion)
        world = PoseSeries.from_matrices(
            times,
            femur.positions + np.einsum("nij,nj->ni", femur.matrices(), patella.positions),
            femur.matrices() @ patella.matrices(),
        )
        femur, tibia, world = (self._poses_of_markers(each, random) for each in (femur, tibia, world))
        relative = world.relative_to(femur)
        if self.turn:
            turn = Rotation.from_rotvec(constant.normal(0.0, self.turn, 3)).as_matrix()
            relative = PoseSeries.from_matrices(times, relative.positions @ turn.T, turn @ relative.matrices())
        point = np.asarray(scene.tracked_point().array(), dtype=float)
        center = relative.positions + relative.matrices() @ point + constant.normal(0.0, self.placement, 3)
        late = constant.normal(0.0, self.time_shift)
        if not first:
            late = random.spawn(1)[0].normal(0.0, self.time_shift)
        forces = {}
        for name, value in motion.forces.items():
            scaled = np.interp(times - late, times, value) * (1 + constant.normal(0.0, self.force_scale))
            zero = random.normal(0.0, self.force_bias)
            forces[name] = scaled + zero + random.normal(0.0, self.force_noise, value.shape)
        spring_forces: dict[str, Any] = {kind: forces.get(name) for name, kind in force_fields(scene, springs).items()}
        measured = Measured(
            times,
            center,
            relative.quaternions,
            **spring_forces,
            synthetic=True,
            source="a plant",
            readings={name: self._reading(motion, name, random) for name in self.readings},
        )
        bones = (femur, tibia) if knee_motion.femur is not None else (None, tibia.relative_to(femur))
        return KneeMotion.from_poses(*bones), measured

    def _poses_of_markers(self, true: PoseSeries, random: np.random.Generator) -> PoseSeries:
        places = self.cluster * _CORNERS
        markers = true.positions[:, None] + np.einsum("nij,mj->nmi", true.matrices(), places)
        markers = markers + random.normal(0.0, self.marker_noise, markers.shape)
        if self.cutoff is not None:
            markers = butterworth_lowpass(markers, true.rate, self.cutoff)
        return cluster_poses(markers, places, true.times)

    def _reading(self, motion: PlantMotion, name: str, random: np.random.Generator) -> Floats:
        owner, _, key = name.rpartition(".")
        value = motion.reported.get(owner, {}).get(key)
        if value is None:
            raise InputError(f"{name} is no single number a frame", where="laboratory", expected="another reading")
        return value + random.normal(0.0, self.readings[name], value.shape)
