"""Treatments of the extensor mechanism: the tibial tuberosity, the patellar tendon, the quadriceps."""

from __future__ import annotations

from fitting.treatments.parts import PATELLAR_TENDON, QUADRICEPS, Amount, elastic, line_element, toward
from pftwin.model.scene import Scene


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
        scene: whose tibia frame has x proximal, y lateral and z anterior.
        medialisation: towards the midline.
        anteriorisation: towards the front.
        distalisation: towards the foot.
        tendon: name of the patellar tendon in the scene.

    Raises:
        InputError: no such tendon on the tibia.
    """
    found = line_element(scene, tendon, "tibial_tuberosity_transfer", body="tibia")
    return scene.with_effect(found.with_origin_moved(toward(medialisation, distalisation, anteriorisation)))


def patellar_tendon_length_change(scene: Scene, lengthening: Amount = 0.0, *, tendon: str = PATELLAR_TENDON) -> Scene:
    """The scene with a longer patellar tendon, or a shorter one where `lengthening` is negative [m].

    The length that changes is the slack length; of strands, every strand's alike. Tenodesis or imbrication shortens.

    Raises:
        InputError: no such tendon on the tibia.
    """
    return _lengthened(scene, lengthening, tendon, "patellar_tendon_length_change", "tibia")


def quadriceps_lengthening(scene: Scene, lengthening: Amount = 0.0, *, tendon: str = QUADRICEPS) -> Scene:
    """The scene with a longer quadriceps tendon [m]: its slack length grows, so it pulls less.

    Raises:
        InputError: no such tendon; a quadriceps that pulls with a prescribed tension, which no length changes.
    """
    return _lengthened(scene, lengthening, tendon, "quadriceps_lengthening", None)


def _lengthened(scene: Scene, lengthening: Amount, tendon: str, treatment: str, body: str | None) -> Scene:
    return scene.with_effect(elastic(scene, tendon, treatment, body=body).lengthened(lengthening))
