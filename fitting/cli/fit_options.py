"""Options shared by the commands that fit: parameters, measurements and their standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import numbers_between_colons, numbers_by_name
from pftwin.cli.scenes import Chosen, TrialsOptions

if TYPE_CHECKING:
    from pftwin.model.scene import Scene

DuringOption = Annotated[
    list[str] | None,
    Option("--during", metavar="FROM:TO", help="Compare only measurements within this time span [s]; may be repeated."),
]
_SHARE = 0.3  # default half width of the bounds, as a share of the nominal value
_BOUNDS = 'a share, such as 0.3; or "L1=0.03:0.05", "L1=30:50 mm"'
_SETTLED: dict[str, Any] = {  # defaults of the options that a trained posterior or a calibrated fit has fixed
    "method": "least_squares",
    "objective": "likelihood",
    "free": ("K1", "L1", "K2", "L2"),
    "bounds": _SHARE,
    "use": ("position",),
    "loss": "linear",
    "resume": False,
    "seed": 0,
}


@dataclass(frozen=True)
class ExperimentOptions(TrialsOptions):
    """Options for the trials, the free parameters, and the measurements that determine them."""

    free: Annotated[str, Option(metavar="NAMES", help="Free parameters, separated by commas.")] = "K1,L1,K2,L2"
    use: Annotated[
        str, Option(metavar="CHANNELS", help="Channels to compare: position, orientation, effects' forces; or all.")
    ] = "position"
    noise: Annotated[
        list[str] | None,
        Option(metavar="CHANNEL=SD", help='Standard deviation in m, rad or N, or "0.2 mm"; may be repeated.'),
    ] = None
    nuisance: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="Also fit nuisance parameters, which the scene lacks or knows roughly: rig, mocap, mri; or standard"
            " deviations by name, as in friction=0.05; several with commas, as in rig,damping=0.5.",
        ),
    ] = None
    varies: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=SD",
            help="Standard deviation of a parameter between trials, in its unit or as in L1=0.5 mm; may be repeated.",
        ),
    ] = None

    def load(self) -> list[Chosen]:
        """See `TrialsOptions`; names that are separated by spaces arrive here as scene files."""
        if strays := [str(path) for path in self.scene or [] if not path.suffix and not path.exists()]:
            names = ",".join([self.free, *strays])
            remedy = f"names are separated by commas: --free {names}"
            raise InputError("no such file", where=strays[0], expected="a scene file", remedy=remedy)
        return super().load()

    def asked(self, scene: Scene) -> dict[str, Any]:
        """Keyword arguments for `fitting.fit_tendons`, with units from the scene; InputError for malformed options."""
        return {
            "free": names_in(self.free),
            "use": "all" if self.use.strip() == "all" else names_in(self.use),
            "noise": deviations(self.noise, "--noise", "position=0.2 mm", _unit_of_channel),
            "nuisance": self.nuisance,
            "varies": deviations(self.varies, "--varies", "L1=0.5 mm", units_of(scene)),
        }


@dataclass(frozen=True)
class FitOptions(ExperimentOptions):
    """Also the bounds of the parameters, and the limits of the checks of the measurements."""

    bounds: Annotated[
        list[str] | None,
        Option(
            metavar="BOUNDS",
            help="Bounds on either side, as a share of the nominal value (0.3 if left out); or NAME=LOW:HIGH of one"
            " parameter, in its unit or as in L1=30:50 mm: may be repeated.",
        ),
    ] = None
    limit: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=A:B",
            help="Limits of a check of the measurements, which warns from A and refuses from B on: reading, position,"
            " orientation, force, noise, shift, simulated, trained_noise or set_up.",
        ),
    ] = None

    def asked(self, scene: Scene) -> dict[str, Any]:
        """Keyword arguments for `fitting.fit_tendons`, with units from the scene; InputError for malformed options."""
        given = self.bounds or []
        share = numbers_between_colons(given[0]) if len(given) == 1 else ()
        bounds: Any = _SHARE
        if len(share) == 1:
            (bounds,) = share
        elif given:
            bounds = numbers_by_name(given, "--bounds", _BOUNDS, (2,), units_of(scene))
        return super().asked(scene) | {"bounds": bounds}

    def limits(self) -> dict[str, Any] | None:
        """Parses the limits of each check, from which on it warns and refuses; InputError for malformed ones."""
        return numbers_by_name(self.limit, "--limit", 'such as "force=0.2:0.8"', (2,)) or None


def names_in(text: str) -> tuple[str, ...]:
    """Splits names at commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def deviations(
    given: list[str] | None, option: str, example: str, unit: Callable[[str], str] = lambda name: ""
) -> dict[str, float] | None:
    """Parses standard deviations [SI] from "name=sd", with a unit if the name has one; InputError if malformed."""
    found = numbers_by_name(given, option, f'such as "{example}"', unit=unit)
    return {name: sd for name, (sd,) in found.items()} or None


def units_of(scene: Scene) -> Callable[[str], str]:
    """Returns a function from the name of a scene's parameter to its unit; it raises InputError for unknown names."""
    from pftwin.model.scene_parameters import find

    return lambda name: find(scene, name)[0].unit(scene)


def _unit_of_channel(name: str) -> str:
    return {"position": "m", "orientation": "rad"}.get(name, "" if "." in name else "N")  # dotted: a reading, own unit


def refuse_settled(asked: dict[str, Any], where: str) -> None:
    """Raises InputError if an option that a file given by the option `where` has fixed differs from its default."""
    if settled := [f"--{name}" for name, value in asked.items() if value != _SETTLED.get(name)]:
        raise InputError(
            f"{', '.join(settled)} together with this file", where=where, expected="none, as the file has fixed them"
        )


def time_spans(given: list[str] | None) -> list[tuple[float, ...]]:
    """Parses time spans [s] from "from:to"; InputError for anything else."""
    spans = [numbers_between_colons(text) for text in given or []]
    for text, numbers in zip(given or [], spans, strict=True):
        if len(numbers) != 2:
            raise InputError(f"found {text!r}", where="--during", expected='such as "0:0.5"')
    return spans


def within(scene: Scene, spans: list[Any]) -> Scene:
    """The scene with only the measurements within these time spans; unchanged without spans or measurements."""
    if not spans or scene.measured is None:
        return scene
    return replace(scene, measured=scene.measured.during(spans))
