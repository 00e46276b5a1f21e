"""Nuisance parameters: what a twin omits or knows only roughly, estimated in addition to the requested parameters.

A twin that is taken as exact puts whatever it omits into the requested parameters, and is overconfident of them. With
nuisance parameters the joint may have friction, tendons may be attached elsewhere, and damping may differ from the
scene's; each has a normal prior, and what the measurements leave open of it widens the other intervals. Only what
moves the button is included: bones and button stay as in the scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from fitting.stiffening import Working, linear_tendons, stiffened, stiffening_tendons, working_of
from pftwin.base.errors import InputError
from pftwin.base.quantities import Quantity
from pftwin.model.effects.friction import Friction
from pftwin.model.number_place import TIED, TOGETHER, NumberPlace, named_arrays
from pftwin.model.scene import Scene
from pftwin.model.scene_parameters import find

FRICTION = 0.05  # wet UHMWPE on CoCr, measured 0.04 to 0.10: BioMed Research International 2015:185142, Table 5
SLIP_SPEED = 1e-3  # [m/s]
OF_SENSORS = ("force_scale", "force_bias", "time_shift", "placement", "turn")
DEVIATIONS = ("attachments", "friction", "damping", "stiffening", *OF_SENSORS)  # fields that a text can set
REACH = 4.0  # distance of the bounds from the prior's mean, in standard deviations
_ANY = Quantity("")  # of a parameter with no declared quantity
_SMALLEST_SHARE = 1e-3  # lower bound of a positive parameter, as a share of its mean
_DAMPING = ("N s/m", "N m s/rad")  # units of damping coefficients


class NuisanceNumbers(NamedTuple):
    """Names of nuisance parameters of a scene; bounds, normal priors and kinds by name."""

    names: tuple[str, ...]
    bounds: dict[str, tuple[float, float]]
    priors: dict[str, tuple[float, float]]
    kinds: dict[str, str]  # "attachments", "friction", "damping", "stiffening", "others"


@dataclass(frozen=True)
class Nuisance:
    """What a twin omits or knows only roughly, as standard deviations of priors; 0: as in the scene.

    Args:
        attachments: of each coordinate of both ends of every tendon and of every ligament, whose strands shift
            together [m]: images show where a ligament is attached, not each of its strands. An obstacle on the patella
            shifts with the line's insertion, which would otherwise come to lie inside it.
        friction: of the coefficient between button and femur, whose mean is the scene's, or 0.05 if it has none.
        damping: of each damping coefficient of the patella and the tendons, as a share of the scene's.
        stiffening: not a deviation but the largest share by which linear tendons are stiffer when stretched by a
            quarter of their length. Posteriors by simulations estimate it for each tendon, with a normal prior
            truncated at 0 and this maximum; they report as stiffness and slack length the straight line nearest to its
            spring, over the fitted knee's lengths if both are free. Searches have no such parameter.
        force_scale: scale error of each force sensor, as a share of its reading. This and the following are constant
            throughout a recording, drawn for simulated ones, and not estimated: posteriors by simulations allow for
            them, other methods refuse them.
        force_bias: zero error of each force sensor, in each trial [N].
        time_shift: delay or lead of a trial's forces against the markers [s].
        placement: error of each coordinate of the tracked point in the femur's frame, from registration [m].
        turn: rotation of the femur's frame about each of its axes, from registration [rad]; tracked points and
            orientations turn with it.
        others: of any other parameters of the scene, by name: a tendon's toe strain, a coefficient of the fitted
            surface, a contact's stiffness. A name of an array stands for all its elements.
        working: lengths at which tendons work, by name, over which the lines are nearest; `at_work` computes them from
            the nominal knee. Tendons without them stay linear.
    """

    attachments: float = 0.0
    friction: float = 0.0
    damping: float = 0.0
    stiffening: float = 0.0
    force_scale: float = 0.0
    force_bias: float = 0.0
    time_shift: float = 0.0
    placement: float = 0.0
    turn: float = 0.0
    others: Mapping[str, float] | tuple[tuple[str, float], ...] = ()
    working: tuple[tuple[str, Working], ...] = ()

    def __post_init__(self) -> None:
        known = tuple((name, Working(*(float(x) for x in numbers))) for name, numbers in self.working)
        object.__setattr__(self, "working", known)  # files give lists
        others = tuple((str(name), sd) for name, sd in dict(self.others).items())
        object.__setattr__(self, "others", others)
        for name, value in [*((name, getattr(self, name)) for name in DEVIATIONS), *others]:
            if not (isinstance(value, int | float) and np.isfinite(value) and value >= 0):
                raise InputError(f"{name}: found {value!r}", where="nuisance", expected="a standard deviation, or 0")

    @staticmethod
    def of(given: str | Nuisance | None) -> Nuisance:
        """From a preset's name, "attachments=0.001,friction=0.05", "rig,force_scale=0.02,graft.toe_strain=0.01", or a
        `Nuisance`, which is returned; None gives none: the twin is taken as exact.

        Raises:
            InputError: an unknown preset; a text with another name, or without numbers.
        """
        if given is None or isinstance(given, Nuisance):
            return given or EXACT
        some = f"some of {', '.join(DEVIATIONS)}, as in attachments=0.001, or numbers of the scene by their names"
        expected = f"one of: {', '.join(PRESETS)}; or {some}; or both"
        first, *others = given.split(",")
        preset = PRESETS.get(first.strip())
        found: dict[str, Any] = {}
        for part in [first, *others] if preset is None else others:
            name, _, value = (text.strip() for text in part.partition("="))
            try:
                number = float(value)
            except ValueError:
                raise InputError(f"found {part.strip()!r}", where="nuisance", expected=expected) from None
            if (name not in DEVIATIONS and "." not in name) or name in found:
                raise InputError(f"found {name!r}", where="nuisance", expected=f"{expected}; each once")
            found[name] = number
        others = {name: found.pop(name) for name in [*found] if name not in DEVIATIONS}
        return replace(preset or EXACT, **found, others=others)

    def refuse_sensors(self, by: str) -> None:
        """Refuses sensor errors for a method that cannot allow for them.

        Raises:
            InputError: if there are any.
        """
        if some := [name for name in OF_SENSORS if getattr(self, name)]:
            expected = f"nothing of {', '.join(OF_SENSORS)}"
            remedy = "method='simulations', or a posterior that is trained, which allow for them"
            raise InputError(f"{by} cannot allow for {some[0]}", where="nuisance", expected=expected, remedy=remedy)

    def at_work(self, scenes: Sequence[Scene]) -> Nuisance:
        """A copy with the working lengths of tendons, for stiffening, from simulations of the nominal knee's trials.

        Raises:
            InputError: if a motion is not finite.
        """
        if not self.stiffening or self.working:
            return self
        found = working_of(scenes, linear_tendons(scenes[0]))
        if not all(np.isfinite(lengths).all() for lengths in found.values()):
            raise InputError("the nominal knee finds no finite motion", where=scenes[0].name)
        return replace(self, working=tuple(found.items()))

    def prepared(self, scene: Scene, working: Mapping[str, Working] | None = None) -> Scene:
        """The scene with nuisance effects: friction, if requested and the contact has none, and stiffening tendons
        where working lengths are known. Pure.

        Args:
            scene: scene to prepare.
            working: working lengths, which may be traced arrays; by default those of this object.

        Raises:
            InputError: if friction is requested without a contact, or the contact cannot have friction.
        """
        working = dict(self.working) if working is None else working
        scene = stiffened(scene, working, dict.fromkeys(working, 0.5 * self.stiffening))
        if not self.friction or _friction_name(scene) in named_arrays(scene):
            return scene
        contact = scene.contact
        if contact is None:
            raise InputError("friction without a contact", where="nuisance", expected="a contact of button and femur")
        rough = contact.with_friction(Friction(jnp.asarray(FRICTION, float), jnp.asarray(SLIP_SPEED, float)))
        return scene.with_effect(rough)

    def numbers(self, scene: Scene, but: Sequence[str] = ()) -> NuisanceNumbers:
        """Nuisance parameters of a prepared scene, without those that the names in `but` already cover.

        A zero coefficient in the scene, such as missing damping, stays zero.
        """
        arrays = named_arrays(scene)
        lines = {e.name: line for e in scene.effects if (line := e.line_element()) is not None}
        on_patella = {name for name, line in lines.items() if line.wrap is not None and line.wrap.body == "patella"}
        found: dict[str, tuple[NumberPlace, float, str]] = {}  # by name, with deviation and kind
        declared = {name: number.quantity for name, number in arrays.items() if number.quantity is not None}
        for whole, quantity in declared.items():
            own = arrays[whole]
            if len(own.shape) > 1:  # changes over time
                continue
            # An obstacle's centre has a frame too, but is no attachment of a line.
            attached = quantity.frame in ("patella", "body") and quantity.unit == "m" and own.owner in lines
            if self.attachments and attached:
                names = [whole]
                if quantity.frame == "patella" and own.owner in on_patella:
                    names.append(f"{own.owner}.wrap.center.{own.path[-1]}")
                [place] = find(scene, TIED.join(name + TOGETHER * len(arrays[name].shape) for name in names))
                found[place.name] = place, self.attachments, "attachments"
            elif self.damping and quantity.unit in _DAMPING:
                for place in find(scene, whole):
                    found[place.name] = place, self.damping * float(place.read(scene)), "damping"
        for name, sd in dict(self.others).items():
            own = find(scene, name, "nuisance")  # replaces what the fields above give for the same numbers
            found = {n: each for n, each in found.items() if not any(each[0].overlaps(place) for place in own)}
            found |= {place.name: (place, sd, "others") for place in own}
        if self.friction:
            name = _friction_name(scene)
            found[name] = find(scene, name)[0], self.friction, "friction"
        asked = [place for name in but for place in find(scene, name)]
        priors, bounds, kinds = {}, {}, {}
        for name, (place, sd, kind) in found.items():
            if sd > 0 and not any(place.overlaps(other) for other in asked):
                mean, known = float(place.read(scene)), declared.get(name.partition("[")[0], _ANY)
                least = _SMALLEST_SHARE * mean if known.positive else known.lower
                priors[name], kinds[name] = (mean, sd), kind
                bounds[name] = (max(mean - REACH * sd, least), min(mean + REACH * sd, known.upper))
        stiff = {f"{tendon}.stiffening" for tendon in stiffening_tendons(scene)}
        for name in (f"{tendon}.stiffening" for tendon, _ in self.working):
            if name in stiff and name not in but:
                bounds[name] = (0.0, self.stiffening)
                priors[name] = (0.5 * self.stiffening, self.stiffening / np.sqrt(12))  # truncated at the bounds
                kinds[name] = "stiffening"
        return NuisanceNumbers(tuple(priors), bounds, priors, kinds)


def _friction_name(scene: Scene) -> str:
    contact = scene.contact
    return "" if contact is None else f"{contact.name}.friction.coefficient"


EXACT = Nuisance()  # nothing: the twin is taken as exact
PRESETS = {
    "rig": Nuisance(attachments=1e-3, friction=0.05, damping=0.5, stiffening=0.1),  # parts made to drawings
    "mocap": Nuisance(attachments=5e-3, friction=0.05, damping=0.5, stiffening=0.1),  # attachments found by hand
    "mri": Nuisance(attachments=2e-3, friction=0.05, damping=0.5, stiffening=0.1),  # attachments seen in images
}
