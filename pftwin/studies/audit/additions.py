"""What a scene lacks and could have, as variants of it; and other inertia, and shorter steps."""

from __future__ import annotations

import equinox as eqx

from pftwin.base.errors import InputError
from pftwin.base.leaves import number
from pftwin.base.spatial import Rotation, Vec3
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit, QuasiStatic
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.line_elements import TOE
from pftwin.model.scene import Scene
from pftwin.studies.audit.ablations import together
from pftwin.studies.audit.variant import NotApplicable, Variant

# UHMWPE on CoCr, wet: 0.04 to 0.10 at 3 to 9 MPa in three studies compared by BioMed Res Int 2015:185142, Table 5.
FRICTION = 0.05
SLIP_SPEED = 1e-3  # [m/s]
WEIGHT = 9.81  # [m/s^2]


def additions(scene: Scene, integrator: Integrator) -> list[Variant | NotApplicable]:
    """Friction, weight, a toe region, and inertia more, less or none; and steps half as long, as a yardstick."""
    found = [_friction(scene), _gravity(scene), *_elaborated(scene), *_inertia(scene, integrator)]
    half = Variant("steps half as long", "yardstick", "what the step itself is worth", scene, refine=2)
    return [*(v for v in found if v is not None), half]


def _friction(scene: Scene) -> Variant | NotApplicable | None:
    if any(c.label == "friction" for e in scene.effects for c in e.simplifications()):
        return None
    if scene.contact is None:
        return NotApplicable("friction", "put in", "nothing touches")
    try:
        rough = scene.contact.with_friction(Friction(number(FRICTION), number(SLIP_SPEED)))
    except InputError as error:
        return NotApplicable("friction", "put in", str(error))
    sentence = f"Coulomb, coefficient {FRICTION:g}, slip speed {1e3 * SLIP_SPEED:g} mm/s, in {scene.contact.name}"
    return Variant("friction", "put in", sentence, scene.with_effect(rough))


def _gravity(scene: Scene) -> Variant | None:
    if any(isinstance(e, Gravity) for e in scene.effects):
        return None
    femur = scene.motion.femur
    axes = Rotation.from_array(number([[1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    if femur is not None:
        axes = femur.frames(scene.motion.start_time).rotation
    down = axes.apply(Vec3(number(-WEIGHT), number(0.0), number(0.0)))
    sentence = f"{WEIGHT:g} m/s2 towards the femur's distal end at the first frame: a thigh held upright"
    return Variant("gravity", "put in", sentence, scene.with_effect(Gravity(scene.patella.mass, down)))


def _elaborated(scene: Scene) -> list[Variant | NotApplicable]:
    """What effects say that they lack: toe regions of linear tendons, where no line of force has one already."""
    lacking = [c for e in scene.effects for c in e.elaborations()]
    labels = [c.label for e in scene.effects for c in (*lacking, *e.simplifications())]
    if any(label.startswith(TOE) for label in labels):
        return [*together(scene, "put in", lacking)]
    return [*together(scene, "put in", lacking), NotApplicable(TOE, "put in", "no tendon is linear")]


def _inertia(scene: Scene, integrator: Integrator) -> list[Variant | NotApplicable]:
    def times(factor: float) -> Scene:
        body = scene.patella
        heavier = factor * body.mass, factor * body.inertia
        return eqx.tree_at(lambda s: (s.patella.mass, s.patella.inertia), scene, heavier)

    if not integrator.inertia:
        sentence = "mass and moments of inertia, by linear_implicit"
        return [Variant("patella inertia", "put in", sentence, scene, integrator=LinearImplicit())]
    return [
        _no_inertia(scene),
        Variant("patella inertia x 2", "changed", "mass and moments doubled, weight as it is", times(2.0), alike=True),
        Variant("patella inertia x 1/2", "changed", "mass and moments halved, weight as it is", times(0.5), alike=True),
    ]


def _no_inertia(scene: Scene) -> Variant | NotApplicable:
    try:
        QuasiStatic().refuse_unfit(scene.effects)
    except InputError as error:
        return NotApplicable("patella inertia", "left out", str(error))
    sentence = "no inertia: quasi_static, weight as it is"
    return Variant("patella inertia", "left out", sentence, scene, integrator=QuasiStatic())
