"""Finds the parts of a scene that treatments change; errors name what the scene has instead."""

from __future__ import annotations

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.contact import Contact
from pftwin.model.effects.line_elements import ElasticLine, LineElement
from pftwin.model.scene import Scene

Amount = Scalar | float

PATELLAR_TENDON, QUADRICEPS, MPFL = "patellar_tendon", "quadriceps", "mpfl"
LATERAL = ("lpfl", "lateral_retinaculum")  # accepted names of the lateral strands
_EXPECTED_NAMES = {PATELLAR_TENDON, QUADRICEPS, MPFL, *LATERAL}  # of parts that treatments change unless told otherwise


def line_element(scene: Scene, names: str | tuple[str, ...], treatment: str, body: str | None = None) -> LineElement:
    """The tendon, strands or muscle of that name, or the first that exists of several; it must begin on the body.

    Raises InputError for a name that is missing, is no line of force, or begins on another body.
    """
    wanted = (names,) if isinstance(names, str) else names
    found = next((e for name in wanted for e in scene.effects if e.name == name), None)
    where = _where(scene, treatment)
    if found is None:
        there = _among([e.name for e in scene.effects if e.line_element() is not None], "no tendon and no strands")
        problem = f"no tendon or strands named {' or '.join(map(repr, wanted))}; {there}"
        remedy = "name the part as the scene does"
        if _EXPECTED_NAMES.issuperset(wanted):  # the natural knee has a part of each
            remedy = "the natural knee, which has them (--knee normal), or a scene file that names its own so"
        raise InputError(problem, where=where, remedy=remedy)
    element = found.line_element()
    if element is None:
        problem = f"{found.name!r} is a {type(found).__name__}, which is no line of force"
        raise InputError(problem, where=where, expected="a tendon or strands")
    starts_on = element.line_ends[1]
    if body is not None and starts_on != body:
        raise InputError(f"{found.name!r} begins on the {starts_on}", where=where, expected=f"on the {body}")
    return element


def elastic(scene: Scene, names: str | tuple[str, ...], treatment: str, body: str | None = None) -> ElasticLine:
    """As `line_element`, with a stiffness and a slack length. Raises InputError also for a prescribed tension."""
    element = line_element(scene, names, treatment, body)
    if not element.elastic:
        problem = f"{element.name!r} pulls with a prescribed tension, which no length or stiffness changes"
        raise InputError(problem, where=_where(scene, treatment), expected="a tendon or strands")
    return element  # type: ignore[return-value]


def contact_of(scene: Scene, treatment: str) -> Contact:
    """The contact between button and trochlea. Raises InputError if the scene has none."""
    contact = scene.contact
    if contact is None:
        problem = f"no contact between a button and a trochlea; {_among([e.name for e in scene.effects], 'no effects')}"
        raise InputError(problem, where=_where(scene, treatment), expected="a contact")
    return contact


def fitted_surface(scene: Scene, treatment: str) -> Surface:
    """The smooth surface that the button touches. Raises InputError without contact, or for a mesh."""
    contact = contact_of(scene, treatment)
    surface = contact.fitted_surface()
    if surface is None:
        remedy = ""
        if treatment == "trochleoplasty":
            remedy = "another trochlea of a natural knee: pftwin.rig.knee(anatomy, trochleoplasty={...})"
        raise InputError(
            f"{contact.name!r} is a contact with the femur's mesh, and this treatment changes a fitted surface",
            where=_where(scene, treatment),
            expected='a contact with a surface fitted to the mesh, such as "P5" or "spline"',
            remedy=remedy,
        )
    return surface


def direction_in_knee(medial: Amount, distal: Amount, anterior: Amount) -> Vec3:
    """The vector in a knee's frame (x proximal, y lateral, z anterior)."""
    return Vec3(-distal, -medial, anterior)  # type: ignore[arg-type]


def _where(scene: Scene, treatment: str) -> str:
    return f"{treatment} of {scene.name or 'the scene'}"


def _among(names: list[str], nothing: str) -> str:
    return f"the scene has {', '.join(map(repr, names)) or nothing}"
