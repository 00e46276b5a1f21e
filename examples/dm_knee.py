"""Bring your own knee: the patella of an instrumented total knee replacement, simulated and compared with a recording.

    python examples/dm_knee.py FOLDER_OF_DM_KNEE [--contact patch|mesh] [--degree 6] [--dt 1e-3] [-o dm_knee.nc]

The folder may be omitted if PFTWIN_DATA names the folder that contains dm_knee. docs/bring_your_own_knee.md explains
the steps and the results. Data: subject DM of the sixth Grand Challenge competition (Fregly et al. 2012, J Orthop Res
30:503) as published with OpenSim JAM; the recording is a passive flexion simulated by that code.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation as Turn

import pftwin
from pftwin import InputError, PftwinError
from pftwin.base.spatial import Pose, Quaternion, Rotation, Vec3
from pftwin.dynamics.state import Guide, System
from pftwin.files.mocap import (
    PoseSeries,
    Table,
    butterworth_lowpass,
    fill_gaps,
    mean_cluster,
    read_csv,
    read_poses,
    read_trc,
    segment_poses,
)
from pftwin.geometry import (
    PatchFit,
    SphereFit,
    SurfaceMesh,
    distance_grid,
    fit_patch,
    fit_sphere,
    load_mesh,
    pressing_surface,
    trochlear_region,
)
from pftwin.model.effects import (
    ElasticFoundation,
    Gravity,
    Hertz,
    LinearFoundation,
    Patella,
    PrescribedTension,
    SphereContact,
    StrandGroup,
    checked_layer,
)
from pftwin.model.measured import SYNTHETIC
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene
from pftwin.results.button_cap import check_cap
from pftwin.results.result import Result

# Rows: proximal, lateral and anterior in the data's axes (-x anterior, +y proximal, +z medial: the MPFL's side).
AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
SETTLED, DEEPEST_FLEXION = 0.5, np.radians(80.0)  # the recording settles until 0.5 s
MUSCLES = ("recfem", "vasint", "vaslat", "vasmed")
LIGAMENTS = {"PT": "patellar_tendon", "MPFL": "mpfl", "LPFL": "lpfl"}
TOE_STRAIN = 0.06  # Blankevoort 1991
GRAVITY = np.array([0.0, -9.81, 0.0])  # in the recording's world [m/s^2]
MASS, INERTIA = 0.449, (7.594e-5, 7.594e-5, 1.642e-5)  # [kg], [kg m^2] about the anatomical axes
MASS_CENTRE = (-0.0019, 0.0279, 0.0)  # data's axes [m]; an odd value, from the model that made the recording
LAYER = {"modulus": 46.3e6, "poisson": 0.46, "thickness": 0.005}  # elastic layer on each side [Pa, -, m]
TABLE, TOGETHER = 1e-3, 4  # cube of the table of the femur's depths [m]; triangles of the button that act as one


@dataclass(frozen=True)
class Knee:
    """A scene, the surfaces fitted for it, and the recording to compare with."""

    scene: Scene
    patch: PatchFit
    sphere: SphereFit
    patella: PoseSeries  # recorded, in the femur frame, anatomical axes
    tibia: PoseSeries  # recorded, in the femur frame, anatomical axes
    tensions: Table  # recorded


@dataclass(frozen=True)
class Comparison:
    """Differences between simulation and recording, over n frames."""

    offset: NDArray[np.float64]  # (n, 3) of the sphere's centre: proximal, lateral, anterior [m]
    angles: NDArray[np.float64]  # (n, 3) rotation vector from recorded to simulated, x, y, z of the data's button [deg]
    force: NDArray[np.float64]  # (n, 2) contact force, simulated and in balance with the recorded tensions [N]
    tensions: dict[str, NDArray[np.float64]]  # (n, 2) of each ligament, simulated and recorded [N]

    @property
    def mean_distance(self) -> float:
        """Mean distance of the sphere's centre from its recorded position [m]."""
        return float(np.linalg.norm(self.offset, axis=1).mean())

    @property
    def angle_rms(self) -> NDArray[np.float64]:
        """Root mean square angles about x, y, z of the data's button frame (3,) [deg]."""
        return np.sqrt((self.angles**2).mean(axis=0))

    def __str__(self) -> str:
        x, y, z = self.angle_rms
        lines = [
            f"sphere centre: mean distance {1e3 * self.mean_distance:.2f} mm, rms proximal/lateral/anterior "
            + "/".join(f"{1e3 * v:.2f}" for v in np.sqrt((self.offset**2).mean(axis=0))),
            f"axis angles, rms about the button's x/y/z: {x:.2f}/{y:.2f}/{z:.2f} deg",
        ]
        for name, pair in {"contact force": self.force, **self.tensions}.items():
            rms = np.sqrt(((pair[:, 0] - pair[:, 1]) ** 2).mean())
            lines.append(f"{name}: rms {rms:.1f} N, last frame {pair[-1, 0]:.0f} N against {pair[-1, 1]:.0f} N")
        return "\n".join(lines)


def anatomical(points: ArrayLike) -> NDArray[np.float64]:
    """Converts points or directions (..., 3) from the data's axes to proximal, lateral, anterior axes."""
    return np.asarray(points, dtype=np.float64) @ AXES.T


def array(values: ArrayLike) -> jax.Array:
    """Converts values to a JAX array of the default float type."""
    return jnp.asarray(np.asarray(values), dtype=float)


def vec3(points: ArrayLike) -> Vec3:
    """Converts points (..., 3) to the library's `Vec3`."""
    return Vec3.from_array(array(points))


def read_motion(folder: Path) -> tuple[PoseSeries, PoseSeries, NDArray[np.float64]]:
    """Reads tibia and patella poses in the femur frame, in anatomical axes, and gravity there (3,) [m/s^2].

    The femur moves by less than 0.13 mm and 0.03 deg, so its frame serves as the world.
    """
    path = folder / "passive_flexion_poses.csv"
    flexion = read_csv(path, units="1")
    end = float(flexion.times[flexion.column("knee_flexion") <= DEEPEST_FLEXION].max())
    poses = {body: p.between(SETTLED, end) for body, p in read_poses(path, ("femur", "tibia", "patella")).items()}
    turn = Pose(Vec3.zero(), Quaternion.from_rotation(Rotation.from_array(array(AXES.T))))
    tibia, patella = (
        poses[body].relative_to(poses["femur"]).compose(turn).seen_from(turn) for body in ("tibia", "patella")
    )
    return tibia, patella, anatomical(poses["femur"].matrices()[0].T @ GRAVITY)


def read_surface(path: Path) -> SurfaceMesh:
    """Reads a mesh in anatomical axes."""
    mesh = load_mesh(path, units="m")
    return replace(mesh, vertices=anatomical(mesh.vertices))


def read_ligaments(path: Path) -> list[StrandGroup]:
    """Reads the ligaments, one effect with all strands for each."""
    try:
        strands = json.loads(path.read_text(encoding="utf-8"))
        names = {kind: [n for n in strands if n.rstrip("0123456789") == kind] for kind in LIGAMENTS}
        return [_ligament(kind, [strands[n] for n in names[kind]]) for kind in LIGAMENTS]
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"no usable list of strands ({error!r})", where=path) from error


def _ligament(kind: str, strands: list[dict]) -> StrandGroup:
    ends = [dict(strand["points"]) for strand in strands]
    (body,) = {name for pair in ends for name in pair if name != "patella"}
    return StrandGroup(
        stiffness=array([s["linear_stiffness_N_per_strain"] for s in strands]),
        slack_length=array([s["slack_length_m"] for s in strands]),
        toe_strain=array(np.full(len(strands), TOE_STRAIN)),
        damping_time=array([s["damping"] for s in strands]),
        insertion=vec3(anatomical([pair["patella"] for pair in ends])),
        origin=vec3(anatomical([pair[body] for pair in ends])),
        body=body,
        name=kind.lower(),
    )


def read_quadriceps(path: Path, start: float, end: float) -> PrescribedTension:
    """Reads the prescribed muscle tensions; if a muscle wraps, its last point on the femur moves."""
    table = read_csv(path).between(start, end)

    def points(kind: str) -> NDArray[np.float64]:
        return anatomical(np.stack([table.select([f"{m}_{kind}_{c}" for c in "xyz"]).values for m in MUSCLES], axis=1))

    return PrescribedTension(
        tension=array(np.stack([table.column(f"{m}_tension") for m in MUSCLES], axis=1)),
        origin=vec3(points("via_femur")),
        insertion=vec3(points("insertion_patella")[0]),
        start_time=float(table.times[0]),
        interval=1 / table.rate,
        body="femur",
        name="quadriceps",
    )


def foundation_law(radius: float) -> Hertz:
    """Returns the elastic foundation of two layers under a sphere as a contact law F = pi K R d^2.

    A layer has the pressure p = k d with k = E (1 - nu) / ((1 + nu) (1 - 2 nu) h), and two in series have K = k / 2. At
    the depth d in a flat facet, the sphere displaces the volume pi R d^2, and the force is K times that. Summed over
    the fitted groove, the force varies as d to the power 2.01 to 2.14, and is 0.93 to 1.37 times this law.
    """
    nu = LAYER["poisson"]
    layer = LAYER["modulus"] * (1 - nu) / ((1 + nu) * (1 - 2 * nu) * LAYER["thickness"])
    return Hertz(array(np.pi * layer / 2 * radius), hertz_exponent=2.0)


def layers(femur: SurfaceMesh, button: SurfaceMesh) -> ElasticFoundation:
    """Returns the contact law of the recording, an elastic layer on each side, with depths from a table for speed."""
    layer = checked_layer(LAYER["modulus"], LAYER["poisson"], LAYER["thickness"])
    sides = distance_grid(femur, TABLE), pressing_surface(button, TOGETHER)
    return ElasticFoundation(*sides, LinearFoundation(layer, layer), vec3(np.zeros(3)))


def build(folder: Path, *, degree: int = 6, cap_tolerance: float = 0.02e-3, contact: str = "patch") -> Knee:
    """Builds the knee from the files of a folder.

    Args:
        folder: folder of the files.
        degree: degree of the trochlear polynomial.
        cap_tolerance: largest deviation of the button's dome from a sphere [m].
        contact: "patch", a sphere on the polynomial, or "mesh", the button's triangles on the femur's.
    """
    if not folder.is_dir():
        raise InputError("no such folder", where=folder, remedy="name the folder that holds dm_knee's files")
    tibia, patella, gravity = read_motion(folder)
    femur = read_surface(folder / "femoral_component_contact.stl")
    region = trochlear_region(
        femur, anterior=(0, 0, 1), proximal=(1, 0, 0), angles=(-np.radians(80.0), np.radians(60.0))
    )
    patch = fit_patch(femur, degree=degree, chart="cylinder", region=region)
    button = read_surface(folder / "patellar_button_contact.stl")
    sphere = fit_sphere(button, axis=(0, 0, -1), tolerance=cap_tolerance)
    start, end = patella.times[[0, -1]]
    effects = (
        *read_ligaments(folder / "ligaments.json"),
        read_quadriceps(folder / "passive_flexion_quadriceps.csv", start, end),
        Gravity(array(MASS), vec3(gravity)),
        layers(femur, button)
        if contact == "mesh"
        else SphereContact(patch.patch, foundation_law(sphere.radius), vec3(sphere.center), array(sphere.radius)),
    )
    body = PatellaBody(array(MASS), vec3(INERTIA), vec3(anatomical(MASS_CENTRE)))
    recorded = Pose(vec3(patella.positions[0]), Quaternion.from_array(array(patella.quaternions[0])))
    motion = KneeMotion.from_poses(None, tibia)
    scene = Scene(body, effects, motion, recorded, name="DM knee", synthetic=True)  # OpenSim JAM computed the motion
    tensions = read_csv(folder / "passive_flexion_tensions.csv").between(start, end)
    return Knee(scene, patch, sphere, patella, tibia, tensions)


def compare(knee: Knee, result: Result) -> Comparison:
    """Compares the simulated patella with the recorded one.

    Raises:
        InputError: the simulation is not finite in all frames.
    """
    offset, angles = pose_errors(knee, result)
    tensions = {
        kind: np.stack([result.effects[kind.lower()]["tension"], knee.tensions.column(name)], axis=1)
        for kind, name in LIGAMENTS.items()
    }
    force = np.stack([result.effects["contact"]["force"], demanded_force(knee)], axis=1)
    return Comparison(offset, angles, force, tensions)


def recorded_center(knee: Knee) -> NDArray[np.float64]:
    """Returns the recorded centre of the button's sphere in the femur frame (n, 3) [m]."""
    return knee.patella.positions + np.einsum("nij,j->ni", knee.patella.matrices(), knee.sphere.center)


def pose_errors(knee: Knee, result: Result) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns offset (n, 3) [m] and angles (n, 3) [deg] of the simulated patella; see `Comparison`.

    Raises:
        InputError: the simulation is not finite in all frames.
    """
    if pftwin.Status.NOT_FINITE in result.status:
        raise InputError("the simulation did not stay finite", where=result.scene_name, remedy="a smaller time step")
    recorded = Turn.from_quat(knee.patella.quaternions, scalar_first=True)
    simulated = Turn.from_quat(result.quaternion, scalar_first=True)
    angles = (recorded.inv() * simulated).as_rotvec(degrees=True) @ AXES  # back to the data's axes
    center = result.position + simulated.apply(knee.sphere.center)
    return center - recorded_center(knee), angles


def pulls_at_recorded_poses(knee: Knee) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Returns, for every effect except contact, its force (n, 3) in femur axes and its tension (n,) [N].

    All velocities are zero, as for the recorded tensions.
    """
    system, com = System.of(knee.scene), knee.scene.patella.center_of_mass
    guides = Guide.sample(knee.scene.motion, array(knee.patella.times))
    still = jax.tree.map(jnp.zeros_like, (guides.tibia.velocity, guides.tibia.angular_velocity))
    guides = eqx.tree_at(lambda g: (g.tibia.velocity, g.tibia.angular_velocity), guides, still)

    def look(position: Vec3, orientation: Quaternion, guide: Guide) -> dict:
        at = position + orientation.rotate(com)
        now = guide.instant(Patella.at_rest(at, orientation), 0.0)
        dry = [e for e in system.effects if e.name != "contact"]
        seen = {e.name: (e.load(now, None)[0].total().force.array(), e.observe(now, None)) for e in dry}
        return {name: (force, report.get("tension", jnp.zeros(()))) for name, (force, report) in seen.items()}

    poses = vec3(knee.patella.positions), Quaternion.from_array(array(knee.patella.quaternions))
    return jax.device_get(jax.jit(jax.vmap(look))(*poses, guides))


def demanded_force(knee: Knee) -> NDArray[np.float64]:
    """Returns the contact force (n,) [N] that balances the recorded tensions and the weight at the recorded poses."""
    total = np.zeros((knee.patella.times.size, 3))
    for name, (force, tension) in pulls_at_recorded_poses(knee).items():
        column = LIGAMENTS.get(name.upper())
        if column is not None:  # the recorded tension along these lines
            taut = tension > 0
            factor = np.where(taut, knee.tensions.column(column), 0.0) / np.where(taut, tension, 1.0)
            force = factor[:, None] * force
        total += force
    return np.linalg.norm(total, axis=1)


def gait_motion(folder: Path) -> KneeMotion:
    """Reads the optical motion capture of the same subject's gait as motion of femur and tibia."""
    clusters = {
        bone: [f"R_{bone}_{place}" for place in ("Superior", "Inferior", "Lateral")] for bone in ("Thigh", "Shank")
    }
    raw = read_trc(folder / "DM_smooth1_new.trc").select([m for names in clusters.values() for m in names])
    filled, _ = fill_gaps(raw)
    smooth = filled.with_positions(butterworth_lowpass(filled.positions, filled.rate, 12.0))
    femur, tibia = (segment_poses(smooth, mean_cluster(smooth, names), source=n) for n, names in clusters.items())
    return KneeMotion.from_poses(femur, tibia)


def run(folder: Path, *, degree: int = 6, dt: float = 1e-3, contact: str = "patch") -> tuple[Knee, Result, Comparison]:
    """Builds the knee, simulates it, and compares the result with the recording."""
    knee = build(folder, degree=degree, contact=contact)
    result = pftwin.simulate(knee.scene, dt=dt)
    return knee, result, compare(knee, result)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    data = os.environ.get("PFTWIN_DATA")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?" if data else None, default=data and Path(data) / "dm_knee")
    parser.add_argument("--degree", type=int, default=6, help="degree of the trochlear polynomial")
    parser.add_argument("--contact", choices=("patch", "mesh"), default="patch", help="sphere on a patch, or meshes")
    parser.add_argument("--dt", type=float, default=1e-3, help="time step [s]")
    parser.add_argument("-o", "--out", type=Path, help="NetCDF file to write")
    given = parser.parse_args(arguments)
    pftwin.configure()
    try:
        knee, result, comparison = run(given.folder, degree=given.degree, dt=given.dt, contact=given.contact)
        print(SYNTHETIC, knee.patch, knee.sphere, result.summary(), comparison, sep="\n")
        if given.contact == "patch":
            print(f"button: {check_cap(result, knee.sphere).describe()}")
        gait = gait_motion(given.folder)
        print(
            f"gait trial: {gait.n_frames} frames of femur and tibia motion, {gait.start_time:g} to {gait.end_time:g} s"
        )
        if given.out:
            result.save(given.out)
    except PftwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
