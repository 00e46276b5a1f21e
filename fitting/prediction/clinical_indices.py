"""Clinical indices of a scene, as radiologists define them, computed if the scene has their landmarks.

If a scene lacks a landmark the index is None, with the reason; nothing is substituted silently.

TT-TG             Goutallier et al. 1978; Dejour et al. 1994, KSSTA 2:19; on MR images Schoettle
                  et al. 2006, Knee 13:26. It falls as the knee bends: Dietrich et al. 2014, KSSTA 22:214
Q-angle           Brattström 1964, Acta Orthop Scand 35 (Suppl 68)
Caton-Deschamps   Caton et al. 1982, Rev Chir Orthop 68:317
sulcus angle      Brattström 1964; Merchant et al. 1974, J Bone Joint Surg Am 56:1391
inclination       Carrillon et al. 2000 (lateral trochlear inclination)

Differences from radiology: distances and inclinations refer to the femur's medial-lateral axis, not to the tangent of
the posterior condyles, which a scene does not hold; the tuberosity is where the patellar tendon is attached; and the
trochlea is cut at a given share of its groove, while TT-TG and inclination are read in the most proximal slice that
shows it whole, and Merchant's view looks along it at 45 deg of flexion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from fitting.prediction.outcomes import groove_surface
from fitting.treatments.parts import PATELLAR_TENDON, QUADRICEPS, line_element
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.base.spatial import Vec3
from pftwin.dynamics.trajectory import knee_angles
from pftwin.geometry.patch.closest import Surface, rectangle_of
from pftwin.model.scene import Scene
from pftwin.results.tracking import groove_line

LEVEL = 0.25  # section of the trochlea, as a share of the groove's length from its proximal end
_SAMPLES = 401
_LIFT = (0.02, 0.021)  # two heights whose difference gives the direction out of the bone [m]
_NEAREST = np.radians(2.0)  # largest difference of a recorded flexion from the requested one
# Usual values of natural knees on X-rays, CT or MR images: text for readers, not used in computations.
USUAL = {
    "tt_tg": (
        "above some 15 to 20 mm abnormal in extension; healthy knees 15 +- 3 mm there, 10 +- 3 mm at 15 deg and "
        "8 +- 3 mm at 30 deg (Dietrich et al. 2014)"
    ),
    "q_angle": "some 13 deg in men and 18 deg in women, in extension",
    "caton_deschamps": (
        "0.96 +- 0.13 in men, 0.99 +- 0.13 in women, from 10 to 80 deg of knee flexion; 1.2 and more patella alta, "
        "0.8 and less patella infera (Caton and Deschamps)"
    ),
    "sulcus_angle": "135 +- 10 deg; above 145 to 150 deg dysplastic",
    "lateral_trochlear_inclination": "below 11 deg dysplastic (Carrillon et al. 2000)",
}


class ClinicalIndex(NamedTuple):
    """One index: its value (None if not known), its unit, and how it was measured or why it was not."""

    value: float | None
    unit: str
    note: str


@dataclass(frozen=True)
class Landmarks:
    """Points that a scene does not hold, (3,) each [m]; None if not known."""

    asis: ArrayLike | None = None  # anterior superior iliac spine, femur frame at the first frame
    tibial_plateau: ArrayLike | None = None  # anterosuperior corner of the tibial plateau, tibia frame
    articular_inferior: ArrayLike | None = None  # lower end of the patella's articular surface, patella frame
    articular_superior: ArrayLike | None = None  # its upper end


@dataclass(frozen=True)
class ClinicalIndices:
    """The clinical indices of a scene."""

    tt_tg: ClinicalIndex  # lateral distance from the groove's bottom to the tibial tuberosity [mm]
    q_angle: ClinicalIndex  # positive if the tuberosity lies lateral of the quadriceps' line [deg]
    caton_deschamps: ClinicalIndex
    sulcus_angle: ClinicalIndex  # [deg]
    lateral_trochlear_inclination: ClinicalIndex  # [deg]

    def describe(self) -> str:
        """One line per index, with the usual values of the literature."""
        lines = []
        for name in self.__dataclass_fields__:
            index: ClinicalIndex = getattr(self, name)
            value = "not known" if index.value is None else f"{index.value:.2f} {index.unit}".rstrip()
            usual = "" if index.value is None else f"; usual in natural knees: {USUAL[name]}"
            lines.append(f"{name.replace('_', ' ')}: {value} ({index.note}){usual}")
        return "\n".join(lines)


def clinical_indices(
    scene: Scene,
    *,
    flexion: float | None = None,
    level: float = LEVEL,
    landmarks: Landmarks | None = None,
    tendon: str = PATELLAR_TENDON,
    quadriceps: str = QUADRICEPS,
) -> ClinicalIndices:
    """Computes the clinical indices of a scene.

    Args:
        scene: scene whose femur and tibia have x proximal, y lateral, z anterior. The femur's y axis stands for the
            posterior condylar line.
        flexion: knee flexion at which TT-TG is measured [rad]; by default the smallest recorded.
        level: position of the axial section through the trochlea: 0 the groove's proximal end, 1 its distal end.
        landmarks: points that are not part of a scene.
        tendon: name of the patellar tendon, whose origin is the tibial tuberosity.
        quadriceps: name of the quadriceps tendon.

    Raises:
        InputError: a level outside 0 to 1, a flexion that was not recorded, landmarks that are not points.
    """
    if not 0 <= level <= 1:
        raise InputError(f"found {level!r}", where="level", expected="a number from 0 (proximal) to 1 (distal)")
    known = landmarks or Landmarks()
    for name in known.__dataclass_fields__:
        point = getattr(known, name)
        if point is not None and (np.shape(point) != (3,) or not np.isfinite(np.asarray(point, dtype=float)).all()):
            raise InputError(f"found {point!r}", where=f"landmarks.{name}", expected="three finite numbers [m]")
    try:
        cut, missing = section(groove_surface(scene), level), ""
    except InputError as error:
        cut, missing = None, error.problem
    return ClinicalIndices(
        _tt_tg(scene, cut, missing, flexion, tendon),
        _q_angle(scene, known, tendon, quadriceps),
        _caton_deschamps(scene, known),
        ClinicalIndex(None, "deg", missing) if cut is None else _sulcus_angle(cut),
        ClinicalIndex(None, "deg", missing) if cut is None else _inclination(cut),
    )


def _tt_tg(
    scene: Scene, cut: TrochlearSection | None, missing: str, flexion: float | None, tendon: str
) -> ClinicalIndex:
    angles = np.asarray(knee_angles(scene).flexion, dtype=np.float64)
    frame = int(np.argmin(angles if flexion is None else np.abs(angles - flexion)))
    if flexion is not None and abs(angles[frame] - flexion) > _NEAREST:
        low, high = np.degrees([angles.min(), angles.max()])
        raise InputError(
            f"a knee flexion of {np.degrees(flexion):.1f} deg was not recorded",
            where="flexion",
            expected=f"radians from {np.radians(low):.3f} to {np.radians(high):.3f} ({low:.0f} to {high:.0f} deg)",
        )
    if cut is None:
        return ClinicalIndex(None, "mm", missing)
    tuberosity = _tuberosity(scene, tendon, frame)
    if isinstance(tuberosity, str):
        return ClinicalIndex(None, "mm", tuberosity)
    note = f"at {np.degrees(angles[frame]):.1f} deg of knee flexion, along the femur's medial-lateral axis; {cut.note}"
    return ClinicalIndex(1e3 * float(tuberosity[1] - cut.bottom[1]), "mm", note)


def _tuberosity(scene: Scene, tendon: str, frame: int) -> Floats | str:
    """The patellar tendon's origin (mean over strands) in the femur's frame, (3,); or why it is not known."""
    try:
        element = line_element(scene, tendon, "clinical_indices", body="tibia")
        origin = _middle(element.origin_at(scene.motion.times[frame]))
    except InputError as error:
        return error.problem
    return _of_tibia(scene, origin, frame)


def _q_angle(scene: Scene, known: Landmarks, tendon: str, quadriceps: str) -> ClinicalIndex:
    """Q-angle in the frontal plane at the first frame, with the patella at the scene's start pose."""
    if known.asis is not None:
        above, line = np.asarray(known.asis, dtype=np.float64), "from the anterior superior iliac spine"
    else:
        pull = next((e.line_element() for e in scene.effects if e.name == quadriceps), None)
        if pull is None or pull.line_ends[1] != "femur":
            why = "neither the iliac spine nor a quadriceps tendon from the femur is in the scene"
            return ClinicalIndex(None, "deg", why)
        above = _middle(pull.origin_at(scene.motion.start_time))
        line = "along the quadriceps' line of pull: the iliac spine is not in the scene"
    below = _tuberosity(scene, tendon, 0)
    if isinstance(below, str):
        return ClinicalIndex(None, "deg", below)
    button = _patella(scene, scene.tracked_point())
    up, down = above - button, button - below
    angle = np.arctan2(up[1], up[0]) - np.arctan2(down[1], down[0])
    return ClinicalIndex(float(np.degrees(angle)), "deg", f"{line}; {_at_start(scene)}")


def _caton_deschamps(scene: Scene, known: Landmarks) -> ClinicalIndex:
    points = {n: getattr(known, n) for n in ("tibial_plateau", "articular_inferior", "articular_superior")}
    if absent := [n.replace("_", " ") for n, p in points.items() if p is None]:
        return ClinicalIndex(None, "", f"not in the scene and not given as landmarks: {', '.join(absent)}")
    plateau, low, high = (np.asarray(p, dtype=np.float64) for p in points.values())
    corner = _of_tibia(scene, plateau, 0)
    ratio = np.linalg.norm(_patella(scene, Vec3(*low)) - corner) / np.linalg.norm(high - low)
    return ClinicalIndex(float(ratio), "", _at_start(scene))


def _sulcus_angle(cut: TrochlearSection) -> ClinicalIndex:
    if cut.medial_ridge is None or cut.lateral_ridge is None:
        return ClinicalIndex(None, "deg", f"{cut.no_ridge()}; {cut.note}")
    a, b = cut.medial_ridge - cut.bottom, cut.lateral_ridge - cut.bottom
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return ClinicalIndex(float(np.degrees(np.arccos(cosine))), "deg", cut.note)


def _inclination(cut: TrochlearSection) -> ClinicalIndex:
    """Inclination of the line nearest to the lateral facet from the femur's medial-lateral axis, in the section."""
    if cut.lateral_ridge is None:
        return ClinicalIndex(None, "deg", f"{cut.no_ridge()}; {cut.note}")
    facet = cut.lateral_facet - cut.lateral_facet.mean(axis=0)
    along = np.linalg.svd(facet, full_matrices=False)[2][0]
    lateral = np.array([0.0, 1.0, 0.0])
    lateral = lateral - (lateral @ cut.normal) * cut.normal
    lateral /= np.linalg.norm(lateral)
    outward = cut.outward - (cut.outward @ lateral) * lateral
    along = along if along @ lateral > 0 else -along
    angle = np.arctan2(along @ outward / np.linalg.norm(outward), along @ lateral)
    return ClinicalIndex(float(np.degrees(angle)), "deg", f"against the femur's medial-lateral axis; {cut.note}")


def _at_start(scene: Scene) -> str:
    return f"at the start pose, {np.degrees(float(knee_angles(scene).flexion[0])):.1f} deg of knee flexion"


def _of_tibia(scene: Scene, point: Floats, frame: int) -> Floats:
    """A point of the tibia frame (3,) in the femur's frame."""
    femur, tibia = scene.motion.frames(scene.motion.times[frame])
    world = tibia.point(Vec3(*point))
    return host_array(world if femur is None else femur.to_local(world))


def _patella(scene: Scene, point: Vec3) -> Floats:
    """A point of the patella frame in the femur's frame, at the start pose."""
    world = scene.start.apply(point)
    femur, _ = scene.motion.frames(scene.motion.times[0])
    return host_array(world if femur is None else femur.to_local(world))


def _middle(points: Vec3) -> Floats:
    return np.array([float(np.mean(np.asarray(a))) for a in (points.x, points.y, points.z)])


@dataclass(frozen=True)
class TrochlearSection:
    """A cut across a trochlea, as on an axial scan: points in the femur's frame, (3,) each [m].

    A ridge is None if the surface still rises at its edge.
    """

    bottom: Floats
    medial_ridge: Floats | None
    lateral_ridge: Floats | None
    lateral_facet: Floats  # (n, 3) from the bottom to the lateral ridge
    normal: Floats  # unit vector across the section
    outward: Floats  # unit vector in the section, out of the bone
    note: str

    def no_ridge(self) -> str:
        """Which ridges are missing, in words."""
        sides = [s for s, r in (("medial", self.medial_ridge), ("lateral", self.lateral_ridge)) if r is None]
        return f"no {' and no '.join(sides)} ridge: the fitted surface still rises at its edge"


def section(surface: Surface, level: float) -> TrochlearSection:
    """The section at a share of the groove's length from its proximal end, 0 to 1, at constant chart u.

    Raises InputError for a surface without a groove.
    """
    line = groove_line(surface)
    if line is None:
        raise InputError("the trochlea has no groove", where="section", expected="a surface with a groove")
    ends = _points(surface, line.u[[0, -1]], line.v[[0, -1]])
    proximal, distal = (line.u[-1], line.u[0]) if ends[1, 0] > ends[0, 0] else (line.u[0], line.u[-1])
    u = float(proximal + level * (distal - proximal))
    bottom_v = float(line.at(u))
    medial, lateral = (np.linspace(bottom_v, edge, _SAMPLES) for edge in rectangle_of(surface)[1])
    ridges, facets = [], []
    for v in (medial, lateral):
        heights = np.asarray(surface.jet(jnp.full(v.shape, u), jnp.asarray(v)).f)
        top = int(np.argmax(heights))
        points = _points(surface, np.full(v.shape, u), v)
        ridges.append(points[top] if 0 < top < _SAMPLES - 1 else None)
        facets.append(points[: top + 1])
    chart = surface.chart
    low, high = (np.asarray(chart.point(jnp.asarray(u), jnp.asarray(bottom_v), jnp.asarray(h)).array()) for h in _LIFT)
    outward = (high - low) / np.linalg.norm(high - low)
    across = host_array(chart.axes.ey)
    bottom = _points(surface, np.array([u]), np.array([bottom_v]))[0]
    note = f"section at {level:.0%} of the groove from its proximal end"
    (medial_ridge, lateral_ridge), normal = ridges, np.cross(across, outward)
    return TrochlearSection(bottom, medial_ridge, lateral_ridge, facets[1], normal, outward, note)


def _points(surface: Surface, u: Floats, v: Floats) -> Floats:
    """Points on the surface (n, 3), femur frame [m]."""
    a, b = jnp.asarray(u, dtype=float), jnp.asarray(v, dtype=float)
    return np.asarray(surface.chart.point(a, b, surface.jet(a, b).f).array(), dtype=np.float64)
