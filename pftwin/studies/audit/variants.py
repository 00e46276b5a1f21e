"""Parts of a scene, and its variants for an audit: effects omitted or added, and changed inertia."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import jax

from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array, number
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.base import Change, Effect, Instant, Load
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.line_elements import TOE
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import tibia_orientation, tibia_position
from pftwin.model.scene import Scene

Memories = tuple[Any, ...]


@dataclass(frozen=True)
class EffectPart:
    """An effect, or a part of one."""

    name: str
    kind: str  # class that computes it
    index: int  # index of the effect in the scene
    without: Scene  # the scene without it
    forgetting: Callable[[Memories], Memories]  # converts the memories of the complete scene to those of `without`
    of: str | None = None  # the effect of which it is a part


def separable(effect: Effect) -> list[tuple[Change, Callable[[Any], Any]]]:
    """Returns the separable parts of an effect, each with the conversion of its memory to that of the rest."""
    return [(c, c.memory) for c in effect.simplifications() if c.memory is not None]


def parts(scene: Scene) -> list[EffectPart]:
    """Returns all parts of a scene, each effect before its own parts."""
    found = []
    for i, effect in enumerate(scene.effects):
        less = scene.without(effect.name)
        found.append(EffectPart(effect.name, type(effect).__name__, i, less, lambda m, i=i: (*m[:i], *m[i + 1 :])))
        for c, rest in separable(effect):
            forgetting = lambda m, i=i, rest=rest: (*m[:i], rest(m[i]), *m[i + 1 :])  # noqa: E731
            name, kind = f"{effect.name}: {c.label}", c.label.capitalize()
            found.append(EffectPart(name, kind, i, scene.with_effect(c.effect), forgetting, of=effect.name))
    return found


def load_of(part: EffectPart, effect: Effect, now: Instant, memory: Any) -> list[tuple[float, Load]]:
    """Returns the part's load as a signed sum of loads; `effect` must be prepared by `recentred`."""
    loads = [(1.0, effect.load(now, memory)[0])]
    own = [(c, rest) for c, rest in separable(effect) if part.name == f"{part.of}: {c.label}"]
    return [*loads, *((-1.0, c.effect.load(now, rest(memory))[0]) for c, rest in own)]


Kind = Literal["left out", "added", "changed", "yardstick"]
KINDS: tuple[Kind, ...] = get_args(Kind)  # in the order of tables


@dataclass(frozen=True)
class Variant:
    """A change and the changed scene."""

    name: str
    kind: Kind
    sentence: str  # description of the change
    scene: Scene
    alike: bool = False  # whether only parameter values differ, so that it can run in a batch
    integrator: Integrator | None = None  # replaces the scene's integrator
    refine: int = 1  # factor on the number of steps


@dataclass(frozen=True)
class NotApplicable:
    """A change that does not apply to the scene, and the reason."""

    name: str
    kind: Kind
    reason: str


NAME = "moving-femur inertia"


def without_femur_inertia(scene: Scene) -> Variant | NotApplicable:
    """Returns the variant whose femur frame is treated as inertial, or why there is none."""
    femur = scene.motion.femur
    if femur is None:
        reason = "the femur stands still in this scene, and nothing in it tells how it moved in the world"
        return NotApplicable(NAME, "added", reason)
    effects = {e.name: e.in_still_femur(femur) for e in scene.effects}
    if grounded := [name for name, effect in effects.items() if effect is None]:
        return NotApplicable(NAME, "left out", f"fixed to the ground, which would move then: {', '.join(grounded)}")
    motion, first = scene.motion, femur.frames(scene.motion.start_time)
    tibia = PoseSeries(motion.times, tibia_position(motion), host_array(tibia_orientation(motion)))
    turn = Quaternion.from_rotation(first.rotation).conjugate()
    fixed = dataclasses.replace(
        scene,
        effects=tuple(e for e in effects.values() if e is not None),
        motion=dataclasses.replace(motion, femur=None, tibia=KneeMotion.from_poses(None, tibia).tibia),
        start=Pose(turn.rotate(scene.start.position - first.origin), turn * scene.start.orientation),
    )
    return Variant(NAME, "left out", "the femur's frame taken for an inertial one, weight turning in it", fixed)


def ablations(scene: Scene) -> list[Variant | NotApplicable]:
    """Returns variants without each effect, without separable parts of effects, and without the femur's inertia."""
    found: list[Variant | NotApplicable] = [
        Variant(p.name, "left out", f"the scene without {p.name} ({p.kind})", p.without) for p in parts(scene)
    ]
    shared = (c for e in scene.effects for c in e.simplifications() if c.memory is None)
    return [*found, *changed_together(scene, "left out", shared), without_femur_inertia(scene)]


def changed_together(scene: Scene, kind: Kind, changes: Iterable[Change]) -> list[Variant]:
    """Returns a variant for each label; it changes all effects that have a change with that label."""
    groups: dict[str, list[Change]] = {}
    for change in changes:
        groups.setdefault(change.label, []).append(change)
    found = []
    for label, group in groups.items():
        changed = scene
        for c in group:
            changed = changed.with_effect(c.effect)
        sentence = f"{', '.join(c.effect.name for c in group)}: {group[0].how}"
        alike = jax.tree.structure(changed) == jax.tree.structure(scene)
        found.append(Variant(label, kind, sentence, changed, alike))
    return found


# UHMWPE on CoCr, wet: 0.04 to 0.10 at 3 to 9 MPa in three studies compared by BioMed Res Int 2015:185142, Table 5.
FRICTION = 0.05
SLIP_SPEED = 1e-3  # [m/s]
WEIGHT = 9.81  # [m/s^2]


def additions(scene: Scene, integrator: Integrator) -> list[Variant | NotApplicable]:
    """Returns variants with friction, weight or a toe region added, with other inertia, and with half the step."""
    found = [_friction(scene), _gravity(scene), *_refinements(scene), *_inertia(scene, integrator)]
    half = Variant("steps half as long", "yardstick", "the effect of the time step itself", scene, refine=2)
    return [*(v for v in found if v is not None), half]


def _friction(scene: Scene) -> Variant | NotApplicable | None:
    if any(c.label == "friction" for e in scene.effects for c in e.simplifications()):
        return None
    if scene.contact is None:
        return NotApplicable("friction", "added", "nothing touches")
    try:
        rough = scene.contact.with_friction(Friction(number(FRICTION), number(SLIP_SPEED)))
    except InputError as error:
        return NotApplicable("friction", "added", str(error))
    sentence = f"Coulomb, coefficient {FRICTION:g}, slip speed {1e3 * SLIP_SPEED:g} mm/s, in {scene.contact.name}"
    return Variant("friction", "added", sentence, scene.with_effect(rough))


def _gravity(scene: Scene) -> Variant | None:
    if any(e.is_weight for e in scene.effects):
        return None
    femur = scene.motion.femur
    down = Vec3(number(-WEIGHT), number(0.0), number(0.0))
    if femur is not None:
        down = femur.frames(scene.motion.start_time).rotation.apply(down)
    sentence = f"{WEIGHT:g} m/s2 towards the femur's distal end at the first frame: a thigh held upright"
    return Variant("gravity", "added", sentence, scene.with_effect(Gravity(scene.patella.mass, down)))


def _refinements(scene: Scene) -> list[Variant | NotApplicable]:
    """Refinements that effects offer; toe regions are not applicable if no tendon is linear."""
    lacking = [c for e in scene.effects for c in e.elaborations()]
    known = any(c.label.startswith(TOE) for e in scene.effects for c in (*lacking, *e.simplifications()))
    absent = [] if known else [NotApplicable(TOE, "added", "no tendon is linear")]
    return [*changed_together(scene, "added", lacking), *absent]


def _inertia(scene: Scene, integrator: Integrator) -> list[Variant | NotApplicable]:
    def times(factor: float) -> Scene:
        body = scene.patella
        heavier = factor * body.mass, factor * body.inertia
        return eqx.tree_at(lambda s: (s.patella.mass, s.patella.inertia), scene, heavier)

    if not integrator.inertia:
        sentence = "mass and moments of inertia, by linear_implicit"
        return [Variant("patella inertia", "added", sentence, scene, integrator=LinearImplicit())]
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
