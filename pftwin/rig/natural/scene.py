"""Scene of a natural knee: cartilage contact, four quadriceps muscles, patellar tendon and retinacula."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.surfaces import articular, bones
from pftwin.geometry.contact.depth_sides import pressing_surface
from pftwin.geometry.contact.distance_grid import distance_grid
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.geometry.patch.closest import Surface
from pftwin.geometry.patch.fit import fit_spline
from pftwin.model.drawn_bones import DrawnBones
from pftwin.model.effects.base import Effect
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.scene import PatellaBody, Scene
from pftwin.rig.natural import placing
from pftwin.rig.natural.motion import ACTIVITIES, GRAVITY, RATE, Activity
from pftwin.rig.natural.obstacles import beside_condyle, over_trochlea
from pftwin.rig.retinacula import LIGAMENTS, TOE_STRAIN, strand_group

MODULUS, POISSON = 5e6, 0.45  # of cartilage [Pa], [-], from the model of Lenhart et al. 2015, Ann Biomed Eng 43:2675
LAYER_DAMPING = 2e-3  # of cartilage [s]
DENSITY = 1300.0  # of the patella [kg/m^3]
DRAG = 5.0, 5e-3  # translational and rotational viscous drag [N s/m], [N m s/rad]
# Stiffness of the patellar tendon [N per unit strain]: 660 MPa (Johnson et al. 1994, J Orthop Res 12:796) on 100 mm^2.
TENDON_STIFFNESS = 66e3
TENDON_TOE_STRAIN = 0.03
TOGETHER = 4  # triangles of the patella that are merged into one
GROOVE_ANGLES, GROOVE_HALF_WIDTH = (-75.0, 45.0), 22e-3  # extent of the spline fitted to the trochlea [deg], [m]
GROOVE_TOLERANCE = 0.05e-3  # of that fit [m]
# Parameters that a trochleoplasty changes. The radius sets the groove's floor: depth only raises the ridges.
TROCHLEA = (
    *("sulcus_angle_deg", "lateral_inclination_deg", "facet_ratio"),
    *("trochlear_depth_mm", "trochlear_radius_mm", "prominence_mm"),
)
TABLE = 1e-3  # cell size of the femur's distance grid [m]


def knee(
    anatomy: Anatomy | None = None,
    *,
    activity: str = "squat",
    quadriceps: float = 700.0,
    duration: float = 2.0,
    resolution_mm: float = 1.5,
    trochleoplasty: Mapping[str, float] | None = None,
) -> Scene:
    """Returns a natural knee that moves between 15 and 90 deg of flexion. Motion and loads are invented: `synthetic`.

    Args:
        anatomy: anatomical parameters; by default those of a normal knee.
        activity: "squat", down and up, or "extension", seated against a weight at the ankle, out and back.
        quadriceps: largest total force of the four quadriceps muscles, 20 to 5000 N.
        duration: duration of the motion [s].
        resolution_mm: triangle size, 0.5 to 2 mm; the patella's triangles are half as large.
        trochleoplasty: new values of trochlear parameters after surgery, by their names in `Anatomy`. The attachments
            of tendon, ligaments and muscles stay as they are without surgery.

    Raises:
        InputError: unknown activity, value out of range, anatomy with no patellar position on the trochlea, or a
            resolution that is too coarse.
    """
    limits = {"quadriceps": (quadriceps, 20.0, 5000.0), "resolution_mm": (resolution_mm, 0.5, 2.0)}
    for name, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise InputError(f"found {value!r}", where=name, expected=f"{low:g} to {high:g}")
    if activity not in ACTIVITIES:
        raise InputError(f"found {activity!r}", where="activity", expected=f"one of: {', '.join(ACTIVITIES)}")
    anatomy, done = anatomy or Anatomy(), ACTIVITIES[activity](duration)
    operated = _operated(anatomy, trochleoplasty or {})
    made = bones(anatomy, resolution_mm)._replace(femur=bones(operated, resolution_mm).femur)
    body = _patella_body(made.patella)
    effects = (
        Gravity(body.mass, vector(GRAVITY)),
        _quadriceps(anatomy, operated, quadriceps, done),
        _patellar_tendon(anatomy),
        *(_retinaculum(anatomy, operated, name) for name in LIGAMENTS),
        _cartilage(operated, *articular(made)),
        LinearDamping(*(number(c) for c in DRAG), body="femur"),
    )
    drawn = DrawnBones(made._asdict())
    name = f"natural knee, {activity}"
    return Scene(body, effects, done.motion, _start(operated, done), name, synthetic=True, bones=drawn)


def _operated(anatomy: Anatomy, trochlea: Mapping[str, float]) -> Anatomy:
    if other := sorted(set(trochlea) - set(TROCHLEA)):
        raise InputError(f"found {other[0]!r}", where="trochleoplasty", expected=f"some of: {', '.join(TROCHLEA)}")
    return dataclasses.replace(anatomy, **trochlea)


def _start(anatomy: Anatomy, done: Activity) -> Pose:
    """Pose of the patella in the world at the first frame."""
    place, turn = placing.rest_pose(anatomy, done.flexion[0])
    femur = Rotation.from_euler("Y", done.inclined[0], degrees=True)
    quaternion = (femur * turn).as_quat(scalar_first=True)
    return Pose(vector(1e-3 * femur.apply(place)), Quaternion(*(number(q) for q in quaternion)))


def _patella_body(mesh: SurfaceMesh) -> PatellaBody:
    """Mass properties for uniform density, with the principal axes assumed parallel to the patella's axes."""
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    inertia = DENSITY * np.diag(solid.moment_inertia)
    return PatellaBody(number(DENSITY * mesh.volume), vector(inertia), vector(solid.center_mass))


def _cartilage(anatomy: Anatomy, femur: SurfaceMesh, patella: SurfaceMesh) -> Effect:
    layers = (
        checked_layer(MODULUS, POISSON, 1e-3 * t)
        for t in (anatomy.trochlear_cartilage_mm, anatomy.patellar_cartilage_mm)
    )
    lateral = femur.vertices[femur.faces].mean(axis=1)[:, 1] > 0
    sides = distance_grid(femur, TABLE, lateral.astype(int)), pressing_surface(patella, TOGETHER)
    law, origin = LinearFoundation(*layers), vector((0.0, 0.0, 0.0))
    return ElasticFoundation(*sides, law, origin, number(LAYER_DAMPING), surface=_groove(anatomy, femur))


def _groove(anatomy: Anatomy, femur: SurfaceMesh) -> Surface:
    """A spline fitted to the trochlea, from which results compute the patella's distance from the groove."""
    x, y, z = femur.vertices.T
    angle = np.degrees(np.arctan2(x, z))
    region = (angle > GROOVE_ANGLES[0]) & (angle < GROOVE_ANGLES[1]) & (np.abs(y) < GROOVE_HALF_WIDTH)
    axes = Quaternion.identity().rotation()
    chart = CylindricalChart(Vec3.zero(), axes, number(1e-3 * anatomy.trochlear_radius_mm))
    return fit_spline(femur, chart=chart, region=region, tolerance=GROOVE_TOLERANCE).patch


def _quadriceps(anatomy: Anatomy, operated: Anatomy, largest: float, done: Activity) -> Effect:
    ends = placing.muscles(anatomy)
    shares = np.array([share for share, _ in placing.QUADRICEPS.values()])
    frames = len(done.pull)
    return PrescribedTension(
        number(largest * np.outer(done.pull, shares)),
        vector(1e-3 * np.tile(ends.body, (frames, 1, 1))),
        vector(1e-3 * ends.patella),
        start_time=0.0,
        interval=1 / RATE,
        body="femur",
        wrap=over_trochlea(operated),
        name="quadriceps",
    )


def _patellar_tendon(anatomy: Anatomy) -> Effect:
    """Each strand is at its slack length in `rest_pose` in full extension."""
    ends = placing.patellar_tendon(anatomy)
    slack = 1e-3 * np.linalg.norm(_in_extension(anatomy, ends) - ends.body, axis=1)
    stiffness = np.full_like(slack, TENDON_STIFFNESS) / len(slack)
    patella, body = 1e-3 * ends.patella, 1e-3 * ends.body
    return strand_group("patellar_tendon", "tibia", stiffness, slack, TENDON_TOE_STRAIN, patella, body)


def _retinaculum(anatomy: Anatomy, operated: Anatomy, name: str) -> Effect:
    """MPFL or LPFL: each strand is at its slack length along its wrapped path in full extension.

    Lengths are those over the femur of `anatomy`; in motion it wraps over that of `operated`.
    """
    ends = placing.retinaculum(anatomy, name)
    condyle, other = (beside_condyle(a, placing.SIDES[name]) for a in (anatomy, operated))
    taut = eqx.filter_jit(condyle.around)(*(vector(1e-3 * p) for p in (_in_extension(anatomy, ends), ends.body)))
    slack = np.asarray(taut.length, dtype=float)
    stiffness = LIGAMENTS[name].stiffness * slack / len(slack)
    return strand_group(name, "femur", stiffness, slack, TOE_STRAIN, 1e-3 * ends.patella, 1e-3 * ends.body, other)


def _in_extension(anatomy: Anatomy, ends: placing.Ends) -> Floats:
    """Returns the ends of lines on the patella in full extension (n, 3), femur frame [mm]."""
    place, turn = placing.rest_pose(anatomy, 0.0)
    return place + turn.apply(ends.patella)
