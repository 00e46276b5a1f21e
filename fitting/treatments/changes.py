"""Changes that treatments make: to the extensor mechanism, the patella's button and strands, and the trochlea."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.treatments.parts import (
    LATERAL,
    MPFL,
    PATELLAR_TENDON,
    QUADRICEPS,
    Amount,
    contact_of,
    direction_in_knee,
    elastic,
    fitted_surface,
    line_element,
)
from pftwin.base.errors import InputError
from pftwin.base.spatial import Quaternion, Rotation, Vec3
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.scene import Scene
from pftwin.results.tracking import groove_line


def tibial_tuberosity_transfer(
    scene: Scene,
    medialisation: Amount = 0.0,
    anteriorisation: Amount = 0.0,
    distalisation: Amount = 0.0,
    *,
    tendon: str = PATELLAR_TENDON,
) -> Scene:
    """The scene with the patellar tendon's origin moved on the tibia, along the tibia's anatomical axes [m].

    The tendon keeps its length, so distalisation pulls the patella down. Fulkerson's osteotomy is medialisation with
    anteriorisation (Fulkerson 1983), Elmslie-Trillat's medialisation alone.

    Args:
        scene: scene whose tibia frame has x proximal, y lateral and z anterior.
        medialisation: towards the midline.
        anteriorisation: towards the front.
        distalisation: towards the foot.
        tendon: name of the patellar tendon in the scene.

    Raises:
        InputError: no such tendon on the tibia.
    """
    found = line_element(scene, tendon, "tibial_tuberosity_transfer", body="tibia")
    return scene.with_effect(found.with_origin_moved(direction_in_knee(medialisation, distalisation, anteriorisation)))


def patellar_tendon_length_change(scene: Scene, lengthening: Amount = 0.0, *, tendon: str = PATELLAR_TENDON) -> Scene:
    """The scene with a longer patellar tendon, or a shorter one if `lengthening` is negative [m].

    The slack length changes; for strands, by the same amount in each. Tenodesis or imbrication shortens it.

    Raises:
        InputError: no such tendon on the tibia.
    """
    return scene.with_effect(elastic(scene, tendon, "patellar_tendon_length_change", "tibia").lengthened(lengthening))


def quadriceps_lengthening(scene: Scene, lengthening: Amount = 0.0, *, tendon: str = QUADRICEPS) -> Scene:
    """The scene with a longer quadriceps tendon [m]: its slack length grows, so it pulls less.

    Raises:
        InputError: no such tendon; a quadriceps that pulls with a prescribed tension, which no length changes.
    """
    return scene.with_effect(elastic(scene, tendon, "quadriceps_lengthening").lengthened(lengthening))


def femoral_derotation(scene: Scene, external_rotation: Amount = 0.0, *, tendon: str = QUADRICEPS) -> Scene:
    """The scene with the femur cut above the knee, and its lower part rotated externally [rad].

    Trochlea, ligaments and tibia move with the lower part, whose frame is the femur's: in it the quadriceps' origins
    rotate internally, about the frame's long axis (x), taken as that of the cut. Hip and foot are not considered.

    Raises:
        InputError: no such tendon or muscle on the femur.
    """
    found = line_element(scene, tendon, "femoral_derotation", body="femur")
    origin = found.origin
    angle = jax.numpy.asarray(external_rotation, origin.x.dtype)
    turn = Quaternion.from_rotation_vector(Vec3(angle, 0 * angle, 0 * angle)).rotation()
    return scene.with_effect(found.with_origin_moved(turn.apply(origin) - origin))


_LEFT = 1e-6  # share of its stiffness that a strand keeps when all is released, since it must stay positive


def button_position(
    scene: Scene, medialisation: Amount = 0.0, distalisation: Amount = 0.0, anteriorisation: Amount = 0.0
) -> Scene:
    """The scene with the button elsewhere on the patella, along the patella's axes [m].

    Anteriorisation buries it (a deeper cut, a thinner patella); negative values make the patella thicker. The button's
    sphere centre, whose path results show, moves with it.

    Raises:
        InputError: a scene without a button.
    """
    shift = direction_in_knee(medialisation, distalisation, anteriorisation)
    return scene.with_effect(contact_of(scene, "button_position").with_button_moved(shift))


def lateral_release(scene: Scene, release: Amount = 0.0, *, strands: str | tuple[str, ...] = LATERAL) -> Scene:
    """The scene with the lateral strands cut to a share: `release` 0 leaves them, 1 cuts all (a millionth stays).

    Raises:
        InputError: the scene has no strands of that name.
    """
    found = elastic(scene, strands, "lateral_release")
    return scene.with_effect(found.stiffened(1 - (1 - _LEFT) * release))


def mpfl_graft(
    scene: Scene,
    stiffening: Amount = 0.0,
    shortening: Amount = 0.0,
    proximalisation: Amount = 0.0,
    anteriorisation: Amount = 0.0,
    *,
    strands: str = MPFL,
) -> Scene:
    """The scene with a graft that replaces the medial patellofemoral ligament (MPFL).

    Args:
        scene: scene with strands from the femur to the patella that stand for the ligament.
        stiffening: of the graft relative to the ligament, as a share: 1 is twice as stiff.
        shortening: of the slack length, which tensions the graft [m].
        proximalisation: of the femoral attachment (a missed Schoettle point) [m].
        anteriorisation: of the femoral attachment [m].
        strands: their name in the scene.

    Raises:
        InputError: the scene has no such strands on the femur.
    """
    found = elastic(scene, strands, "mpfl_graft", body="femur")
    moved = found.with_origin_moved(direction_in_knee(0.0, -proximalisation, anteriorisation))
    return scene.with_effect(moved.stiffened(1 + stiffening).lengthened(-shortening))


LOWEST_DEGREE = 4  # least degree of a patch whose groove can be deepened without moving its ridges
_GRID = 61  # points per side on which the shape is fitted


def deepening_shape(surface: PolynomialPatch) -> NDArray[np.float64]:
    """Change of a patch's coefficients for a deepening by one metre; computed on the host, once per surface.

    The groove is lowered along its line and less and less towards the ridges, as (1 - d^2 / w^2)^2 with d the
    distance across the groove from its line and w that of the nearer edge of the patch: a smooth bump, flat at its
    top, so that the groove's line stays where it is, and flat at its edge. The patch's polynomials are fitted to the
    bump by least squares, and scaled so that the line is lowered by one on average.

    Returns:
        (n,) coefficients, dimensionless.

    Raises:
        InputError: a patch without a groove, or of a degree below 4, which cannot be changed in its middle alone.
    """
    if surface.degree < LOWEST_DEGREE:
        raise InputError(
            f"a patch of degree {surface.degree} cannot be deepened in its groove alone",
            where="trochleoplasty",
            expected=f"degree {LOWEST_DEGREE} or more",
            remedy='a scene with contact "P5"',
        )
    line = groove_line(surface)
    if line is None:
        raise InputError("the surface has no groove", where="trochleoplasty", expected="a trochlea with a groove")
    (u0, v0), (half_u, half_v) = (tuple(float(x) for x in pair) for pair in (surface.center, surface.half_size))
    a, b = (g.ravel() for g in np.meshgrid(*[np.linspace(-1, 1, _GRID)] * 2, indexing="ij"))
    bottom = (line.at(u0 + half_u * a) - v0) / half_v
    half_width = 1 - np.abs(bottom)
    bump = np.maximum(1 - ((b - bottom) / half_width) ** 2, 0.0) ** 2
    c, *_ = np.linalg.lstsq(_basis(surface.degree, a, b), -bump, rcond=None)
    on_line = _basis(surface.degree, (line.u - u0) / half_u, (line.v - v0) / half_v) @ c
    return -c / on_line.mean()


def _basis(degree: int, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([a**i * b**j for i, j in exponents(degree)], axis=1)


def patch_of(scene: Scene, treatment: str) -> PolynomialPatch:
    """The trochlea as a polynomial patch.

    Raises:
        InputError: no contact, or a surface of another kind.
    """
    surface = fitted_surface(scene, treatment)
    if not isinstance(surface, PolynomialPatch):
        found = f"the trochlea is a {type(surface).__name__}"
        raise InputError(found, where=treatment, expected="a polynomial patch (P4, P5, ...)")
    return surface


def trochleoplasty(scene: Scene, deepening: Amount = 0.0, *, shape: Array | None = None) -> Scene:
    """The scene with a deeper trochlear groove [m]; see `deepening_shape`. Linear in the depth.

    Args:
        scene: scene whose trochlea is a polynomial patch of degree 4 or more.
        deepening: of the groove's bottom, on average along its line.
        shape: `deepening_shape` of the untreated surface, required if the scene is traced (jit).

    Raises:
        InputError: another kind of surface, no groove, or a traced surface without its shape.
    """
    patch = patch_of(scene, "trochleoplasty")
    if shape is None:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(patch)):
            raise InputError(
                "the groove of a traced surface cannot be found",
                where="trochleoplasty",
                remedy="shape=deepening_shape(surface), found before tracing",
            )
        shape = jax.numpy.asarray(deepening_shape(patch), dtype=float)
    assert not isinstance(patch.coefficients, tuple)
    deeper = patch.coefficients + deepening * shape
    surface = eqx.tree_at(lambda p: p.coefficients, patch, deeper)
    return scene.with_effect(contact_of(scene, "trochleoplasty").with_fitted_surface(surface))


def femoral_component_rotation(
    scene: Scene, external_rotation: Amount = 0.0, flexion: Amount = 0.0, varus: Amount = 0.0
) -> Scene:
    """The scene with the trochlea rotated on the femur, about the origin of the femur's frame [rad].

    The three angles form one rotation vector, so their order does not matter.

    Args:
        scene: scene whose femur frame has x proximal, y lateral and z anterior.
        external_rotation: about the femur's long axis; the trochlea's front turns laterally.
        flexion: about the medial-lateral axis; its front turns distally.
        varus: about the anterior-posterior axis; its distal end turns medially.

    Raises:
        InputError: a scene without a trochlea.
    """
    chart = fitted_surface(scene, "femoral_component_rotation").chart
    zero = 0.0 * chart.origin.x
    turn = Quaternion.from_rotation_vector(Vec3(zero - external_rotation, zero - flexion, zero + varus)).rotation()
    axes = Rotation(*(turn.apply(e) for e in (chart.axes.ex, chart.axes.ey, chart.axes.ez)))
    return _with_chart(scene, turn.apply(chart.origin), axes)


def femoral_component_translation(
    scene: Scene, medialisation: Amount = 0.0, distalisation: Amount = 0.0, anteriorisation: Amount = 0.0
) -> Scene:
    """The scene with the trochlea moved on the femur, along the femur's axes [m].

    Raises:
        InputError: a scene without a trochlea.
    """
    chart = fitted_surface(scene, "femoral_component_translation").chart
    shift = direction_in_knee(medialisation, distalisation, anteriorisation)
    return _with_chart(scene, chart.origin + shift, chart.axes)


def _with_chart(scene: Scene, origin: Vec3, axes: Rotation) -> Scene:
    contact, surface = contact_of(scene, "treatment"), fitted_surface(scene, "treatment")
    moved: Any = eqx.tree_at(lambda s: (s.chart.origin, s.chart.axes), surface, (origin, axes))
    return scene.with_effect(contact.with_fitted_surface(moved))
