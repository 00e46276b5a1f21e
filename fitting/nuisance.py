"""What a twin lacks, or knows only roughly, as numbers that are fitted beside those that are asked for.

A twin that is taken as exact puts whatever it lacks into the parameters that are asked for, and is sure of them. Here
the joint may have friction, tendons may be attached elsewhere, and damping may be other than it is in the scene; each
of these numbers has a normal prior, and what the measurements leave open of it widens the intervals of the others.
Only what moves the button matters: bones and button are as the scene has them.
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
from pftwin.model.number_place import NumberPlace, named_arrays
from pftwin.model.scene import Scene
from pftwin.model.scene_parameters import find

FRICTION = 0.05  # of wet UHMWPE on CoCr 0.04 to 0.10 is measured: BioMed Research International 2015:185142, Table 5
SLIP_SPEED = 1e-3  # [m/s]
OF_SENSORS = ("force_scale", "force_bias", "time_shift", "placement", "turn")
DEVIATIONS = ("attachments", "friction", "damping", "stiffening", *OF_SENSORS)  # what a text can set
REACH = 4.0  # standard deviations from the prior's mean to the bounds
_ANY = Quantity("")  # of a number of which nothing is declared
_SMALLEST_SHARE = 1e-3  # of its mean that a number which must be positive is at least
_DAMPING = ("N s/m", "N m s/rad")  # units of coefficients of damping


class NuisanceNumbers(NamedTuple):
    """Names of numbers of a scene, with bounds, normal priors and what they are by name."""

    names: tuple[str, ...]
    bounds: dict[str, tuple[float, float]]
    priors: dict[str, tuple[float, float]]
    kinds: dict[str, str]  # "attachments", "friction", "damping", "stiffening", "others"


@dataclass(frozen=True)
class Nuisance:
    """What a twin lacks or knows roughly: standard deviations of priors; 0: it is as the scene has it.

    Args:
        attachments: of each coordinate of both ends of every tendon and strand [m].
        friction: of the coefficient between button and femur; its mean is the scene's, or 0.05 where that has none.
        damping: of all damping of the patella and the tendons, as a share of the scene's.
        stiffening: no deviation: by what share linear tendons are stiffer, at most, when stretched by a quarter of
            their length. Posteriors by simulations find it, for each tendon, by a normal prior that is cut off at 0 and
            there; what they tell of its stiffness and slack length is the straight line nearest to its spring, over the
            fitted knee's lengths where both are free. A search has no number for it.
        force_scale: of each force's sensor, as a share of what it reads. This and what follows stay the same throughout
            a recording, are drawn into simulated ones, and have no number of their own: posteriors by simulations allow
            for them, other methods refuse them.
        force_bias: of the zero of each force's sensor, in each trial [N].
        time_shift: by which the forces of a trial are late or early against the markers [s].
        placement: of the tracked point in the femur's frame, each coordinate: bones registered to markers [m].
        turn: of the femur's frame, about each of its axes, likewise [rad]: tracked points and orientations turn with
            it.
        others: of any other numbers of the scene, by name: a tendon's toe strain, a coefficient of the fitted surface,
            a contact's stiffness. A name of several numbers stands for all of them.
        working: at what lengths tendons work, by name, over which lines are nearest: `at_work` finds them for the
            nominal knee. Others stay linear.
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
        object.__setattr__(self, "working", known)  # lists, where it comes from a file
        others = tuple((str(name), sd) for name, sd in dict(self.others).items())
        object.__setattr__(self, "others", others)
        for name, value in [*((name, getattr(self, name)) for name in DEVIATIONS), *others]:
            if not (isinstance(value, int | float) and np.isfinite(value) and value >= 0):
                raise InputError(f"{name}: found {value!r}", where="nuisance", expected="a standard deviation, or 0")

    @staticmethod
    def of(given: str | Nuisance | None) -> Nuisance:
        """Of a preset's name, "attachments=0.001,friction=0.05", "rig,force_scale=0.02,graft.toe_strain=0.01" or
        itself; None: a twin that is taken as exact.

        Raises:
            InputError: no such preset; a text that names something else, or no numbers.
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
        """Refuses errors of sensors, where there is nothing that allows for them.

        Raises:
            InputError: there are some.
        """
        if some := [name for name in OF_SENSORS if getattr(self, name)]:
            expected = f"nothing of {', '.join(OF_SENSORS)}"
            remedy = "method='simulations', or a posterior that is trained, which allow for them"
            raise InputError(f"{by} cannot allow for {some[0]}", where="nuisance", expected=expected, remedy=remedy)

    def at_work(self, scenes: Sequence[Scene]) -> Nuisance:
        """The same, with what is needed to let tendons stiffen: the nominal knee is simulated in its trials.

        Raises:
            InputError: its motion is not finite.
        """
        if not self.stiffening or self.working:
            return self
        found = working_of(scenes, linear_tendons(scenes[0]))
        if not all(np.isfinite(lengths).all() for lengths in found.values()):
            raise InputError("the nominal knee finds no finite motion", where=scenes[0].name)
        return replace(self, working=tuple(found.items()))

    def prepared(self, scene: Scene, working: Mapping[str, Working] | None = None) -> Scene:
        """The scene with whatever is to be fitted in it: with friction, if that is and the contact has none, and with
        tendons that stiffen, of which it is known at what lengths they work. Pure.

        Args:
            scene: to be prepared.
            working: these lengths, as arrays maybe; by default its own.

        Raises:
            InputError: no contact, or one that cannot have friction.
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
        """The numbers of a prepared scene that are fitted beside others, which have these names.

        What is zero in the scene, such as missing damping, stays so.
        """
        arrays = named_arrays(scene)
        lines = {e.name for e in scene.effects if e.line_element() is not None}
        found: dict[str, tuple[NumberPlace, float, str]] = {}  # by name, with deviation and kind
        declared = {name: number.quantity for name, number in arrays.items() if number.quantity is not None}
        for whole, quantity in declared.items():
            # An obstacle's centre has a frame too, and is not where a line is attached.
            attached = quantity.frame in ("patella", "body") and quantity.unit == "m" and arrays[whole].owner in lines
            for place in find(scene, whole) if len(arrays[whole].shape) < 2 else []:
                if self.attachments and attached:
                    found[place.name] = place, self.attachments, "attachments"
                elif self.damping and quantity.unit in _DAMPING:
                    found[place.name] = place, self.damping * float(place.read(scene)), "damping"
        for name, sd in dict(self.others).items():
            own = find(scene, name)  # in the place of what else is known of the same numbers
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
                priors[name] = (0.5 * self.stiffening, self.stiffening / np.sqrt(12))  # cut off at the bounds
                kinds[name] = "stiffening"
        return NuisanceNumbers(tuple(priors), bounds, priors, kinds)


def _friction_name(scene: Scene) -> str:
    contact = scene.contact
    return "" if contact is None else f"{contact.name}.friction.coefficient"


EXACT = Nuisance()  # a twin that is taken as it is
PRESETS = {  # choices
    "rig": Nuisance(attachments=1e-3, friction=0.05, damping=0.5, stiffening=0.1),  # parts made to drawings
    "mocap": Nuisance(attachments=5e-3, friction=0.05, damping=0.5, stiffening=0.1),  # attachments found by hand
    "mri": Nuisance(attachments=2e-3, friction=0.05, damping=0.5, stiffening=0.1),  # attachments seen in images
}
