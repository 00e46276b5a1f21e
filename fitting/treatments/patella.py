"""Treatments at the patella: the button's place on it, and the strands to either side."""

from __future__ import annotations

from fitting.treatments.parts import LATERAL, MPFL, Amount, contact_of, elastic, toward
from pftwin.model.scene import Scene

_LEFT = 1e-6  # share of its stiffness that a strand keeps when all is released: a scene's strands have some


def button_position(
    scene: Scene, medialisation: Amount = 0.0, distalisation: Amount = 0.0, anteriorisation: Amount = 0.0
) -> Scene:
    """The scene with the button elsewhere on the patella, along the patella's axes [m].

    Anteriorisation buries it (a deeper cut, a thinner patella); negative, it makes the patella thicker. The button's
    sphere centre, whose path results show, moves with it.

    Raises:
        InputError: a scene without a button.
    """
    contact = contact_of(scene, "button_position")
    return scene.with_effect(contact.with_button_moved(toward(medialisation, distalisation, anteriorisation)))


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
    """The scene with a graft in the place of the medial patellofemoral ligament (MPFL).

    Args:
        scene: with strands from the femur to the patella that stand for the ligament.
        stiffening: of the graft over the ligament, as a share: 1 is twice as stiff.
        shortening: of the slack length, which tensions the graft [m].
        proximalisation: of the femoral attachment (Schoettle's point, missed) [m].
        anteriorisation: of the femoral attachment [m].
        strands: their name in the scene.

    Raises:
        InputError: the scene has no such strands on the femur.
    """
    found = elastic(scene, strands, "mpfl_graft", body="femur")
    moved = found.with_origin_moved(toward(0.0, -proximalisation, anteriorisation))
    return scene.with_effect(moved.stiffened(1 + stiffening).lengthened(-shortening))
