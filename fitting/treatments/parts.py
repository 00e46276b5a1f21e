"""The parts of a scene that treatments change, and what is said where they are missing."""

from __future__ import annotations

from pftwin.effects.base import Effect
from pftwin.effects.sphere_contact import SphereContact
from pftwin.effects.strands import StrandGroup
from pftwin.effects.tendon import Tendon
from pftwin.errors import InputError
from pftwin.scene import Scene
from pftwin.spatial import Scalar, Vec3

Amount = Scalar | float
Elastic = Tendon | StrandGroup

PATELLAR_TENDON, QUADRICEPS, MPFL = "patellar_tendon", "quadriceps", "mpfl"
LATERAL = ("lpfl", "lateral_retinaculum")  # names that lateral strands go by


def elastic(scene: Scene, names: str | tuple[str, ...], treatment: str, body: str | None = None) -> Elastic:
    """The tendon or strands of that name.

    Args:
        scene: to look in.
        names: its name, or the names it may go by: the first that is there.
        treatment: for the message.
        body: on which it must begin.

    Raises:
        InputError: no such effect; it pulls with a prescribed tension or on another body; the message names what the
            scene has.
    """
    wanted = (names,) if isinstance(names, str) else names
    found = next((e for name in wanted for e in scene.effects if e.name == name), None)
    where = f"{treatment} of {scene.name or 'the scene'}"
    if found is None:
        raise InputError(
            f"no tendon or strands named {' or '.join(repr(n) for n in wanted)}; {_pulling(scene)}",
            where=where,
            remedy="name the part as the scene does",
        )
    if not isinstance(found, Tendon | StrandGroup):
        raise InputError(
            f"{found.name!r} is a {type(found).__name__}, which has no length or origin to change",
            where=where,
            expected="a tendon or strands",
        )
    if body is not None and found.body != body:
        raise InputError(f"{found.name!r} begins on the {found.body}", where=where, expected=f"on the {body}")
    return found


def contact_of(scene: Scene, treatment: str) -> SphereContact:
    """The contact between button and trochlea.

    Raises:
        InputError: the scene has none.
    """
    contact = scene.contact
    if contact is None:
        raise InputError(
            f"no contact between a button and a trochlea; {_all(scene)}",
            where=f"{treatment} of {scene.name or 'the scene'}",
            expected="a sphere contact",
        )
    return contact


def toward(medial: Amount, distal: Amount, anterior: Amount) -> Vec3:
    """The vector, in any of the knee's frames (x proximal, y lateral, z anterior)."""
    return Vec3(-distal, -medial, anterior)  # type: ignore[arg-type]


def _pulling(scene: Scene) -> str:
    names = [e.name for e in scene.effects if isinstance(e, Tendon | StrandGroup)]
    return f"the scene has {', '.join(repr(n) for n in names)}" if names else "the scene has no tendon and no strands"


def _all(scene: Scene) -> str:
    names: list[str] = [e.name for e in scene.effects if isinstance(e, Effect)]
    return f"the scene has {', '.join(repr(n) for n in names)}" if names else "the scene has no effects"
