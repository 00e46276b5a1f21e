"""Command-line options for the amounts of treatments, shared by all commands that accept them."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer import Option

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import amounts_in, several_amounts, units_in_words
from pftwin.cli.plugins import with_former_names, with_options
from pftwin.cli.terminal import show

if TYPE_CHECKING:
    from fitting.treatments import Treatment
    from pftwin.model.scene import Scene


class Amount(NamedTuple):
    """A command-line option and the amount of a treatment that it sets."""

    flag: str
    former: str  # previous name of the option, still accepted; empty if none
    kind: str  # of treatment, a key of `KINDS`
    name: str  # of the amount within that kind
    words: str  # help text
    unit: str = "mm"

    @property
    def parameter(self) -> str:
        """Name of the Python parameter for this option."""
        return self.flag.removeprefix("--").replace("-", "_")

    def in_si(self, values: Any) -> Any:
        """Converts values from the option's unit to SI units."""
        from fitting.treatments import KINDS

        return KINDS[self.kind].amounts[self.name].from_shown(values)


_TTO, _QUADRICEPS = "tibial_tuberosity_transfer", "quadriceps_lengthening"
_ROTATED, _MOVED = "femoral_component_rotation", "femoral_component_translation"
_OSTEOTOMY = "Tibial tubercle osteotomy (TTO): move the tuberosity"
AMOUNTS = (
    Amount("--tto-medial", "--medialise", _TTO, "medialisation", f"{_OSTEOTOMY} medially"),
    Amount("--tto-anterior", "--anteriorise", _TTO, "anteriorisation", f"{_OSTEOTOMY} anteriorly"),
    Amount("--tto-distal", "--distalise", _TTO, "distalisation", f"{_OSTEOTOMY} distally"),
    Amount("--lengthen-tendon", "", "patellar_tendon_length_change", "lengthening", "Lengthen the patellar tendon"),
    Amount("--lengthen-quads", "--lengthen-quadriceps", _QUADRICEPS, "lengthening", "Lengthen the quadriceps tendon"),
    Amount("--trochleoplasty", "--deepen", "trochleoplasty", "deepening", "Deepen the groove"),
    Amount("--rotate-component", "", _ROTATED, "external_rotation", "Rotate femoral component externally", "deg"),
    Amount("--component-medial", "--medialise-component", _MOVED, "medialisation", "Move femoral component medially"),
    Amount("--derotate-femur", "", "femoral_derotation", "external_rotation", "Femoral derotation, externally", "deg"),
    Amount("--button-medial", "--medialise-button", "button_position", "medialisation", "Move the button medially"),
    Amount("--lateral-release", "--release", "lateral_release", "release", "Release the lateral strands", "%"),
    Amount("--tighten-mpfl", "", "mpfl_graft", "shortening", "Shorten the MPFL graft"),
    Amount("--stiffen-mpfl", "", "mpfl_graft", "stiffening", "Stiffen the MPFL graft relative to the ligament", "%"),
    Amount("--mpfl-proximal", "", "mpfl_graft", "proximalisation", "Move the MPFL graft's femoral tunnel proximally"),
    Amount("--mpfl-anterior", "", "mpfl_graft", "anteriorisation", "Move the MPFL graft's femoral tunnel anteriorly"),
)


def show_limits(written: list[str] | None) -> list[str] | None:
    """Callback of options that take limits: if one is "help", lists the outcomes that take a limit and exits."""
    if "help" not in (written or ()):
        return written
    from fitting.treatments.limits import limitable

    rows = tuple((name, ", ".join(u or "number" for u in units), words) for name, units, words in limitable())
    note = 'a limit: name, <= or >=, number and unit, in quotes: "dislocation_margin>=3 mm"'
    show(Sheet("outcomes that take a limit", ("name", "units", "meaning"), rows, words=(0, 2), notes=(note,)))
    raise typer.Exit


Given = list[tuple[Amount, str]]  # amounts and their values as the user wrote them, in the order of `AMOUNTS`


def with_amounts(
    metavar: str, more: str = "", *, argument: str = "amounts", made: Callable[[Given], Any] = lambda given: given
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Returns a decorator that replaces an argument of a command by an option for each amount.

    `metavar` is the form of the options' values, `more` follows the unit in their help, and `made` computes the
    argument from the amounts that the user wrote.
    """
    options = [
        inspect.Parameter(
            a.parameter,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, Option(a.flag, metavar=metavar, help=f"{a.words} [{a.unit}]{more}.")],
        )
        for a in AMOUNTS
    ]

    def written(values: dict[str, str | None]) -> Any:
        return made([(a, text) for a in AMOUNTS if (text := values[a.parameter]) is not None])

    former = with_former_names({a.parameter: a.former for a in AMOUNTS if a.former})
    return lambda command: former(with_options(command, argument, options, written))


def with_treatment(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the amount options to `pftwin simulate`, whose argument `change` maps a scene to the treated scene."""
    return with_amounts("VALUE", argument="change", made=lambda given: lambda scene: treated(scene, given))(command)


def limits(text: str, option: str, unit: str) -> tuple[float, float]:
    """Parses a range such as "0:20" or "0:2 cm" into its ends, in a unit; InputError for anything else."""
    parts = amounts_in(text.split(":"), unit)
    if len(parts) != 2 or not parts[0] < parts[1]:
        raise InputError(f"found {text!r}", where=option, expected=f"FROM:TO, such as 0:20{units_in_words(unit)}")
    return parts[0], parts[1]


def by_kind(given: list[tuple[Amount, Any]]) -> dict[str, dict[str, Any]]:
    """Groups the given amounts by kind of treatment and name, in the order of `AMOUNTS`; InputError for none."""
    if not given:
        raise InputError("no treatment given", expected="at least one amount", remedy="--tto-medial 0:20")
    return {k: {a.name: what for a, what in given if a.kind == k} for k in dict.fromkeys(a.kind for a, _ in given)}


def treated(scene: Scene, given: Given) -> Scene:
    """Applies a treatment to a scene and adds it to the scene's name; InputError for several values of one amount."""
    if not given:
        return scene
    words = [f"{a.flag.removeprefix('--')} {_sole_amount(text, a):g} {a.unit}" for a, text in given]
    return dataclasses.replace(treatment_of(given)(scene), name=", ".join([scene.name, *words]))


def treatment_of(given: Given) -> Treatment:
    """The treatment with one value per amount; InputError for several values of one amount, or if none is given."""
    return _whole([(a, a.in_si(_sole_amount(text, a))) for a, text in given])


def treatment_within(given: Given) -> tuple[Treatment, dict[str, tuple[float, float]]]:
    """A treatment with these amounts at zero, and their ranges [SI] by "kind.name"; InputError for single values."""
    ranges = {f"{a.kind}.{a.name}": a.in_si(limits(text, a.flag, a.unit)) for a, text in given}
    return _whole([(a, 0.0) for a, _ in given]), {
        name: (float(low), float(high)) for name, (low, high) in ranges.items()
    }


def _whole(amounts: list[tuple[Amount, Any]]) -> Treatment:
    from fitting.treatments import Treatment

    whole = Treatment()
    for kind, own in by_kind(amounts).items():
        whole = whole.then(Treatment.of(kind, own))
    return whole


def _sole_amount(text: str, amount: Amount) -> float:
    found = several_amounts(text, amount.flag, amount.unit)
    if len(found) > 1:
        raise InputError(
            f"{len(found)} values", where=amount.flag, expected="one value", remedy="pftwin treat takes several"
        )
    return found[0]
