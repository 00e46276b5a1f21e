"""Options that select the scene of a command: a file, a case of the virtual rig, or the natural knee."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import amount
from pftwin.cli.plugins import with_options
from pftwin.cli.terminal import progress, spinner, start_computing, tell

if TYPE_CHECKING:
    from pftwin.dynamics.integrator import Integrator
    from pftwin.geometry.patch.sphere import SphereFit
    from pftwin.model.scene import Scene
    from pftwin.results.result import Result

SceneArgument = Annotated[
    Path | None, Argument(metavar="[SCENE.toml]", help="Scene file; `pftwin init` writes an example.")
]
CaseOption = Annotated[
    int | None, Option("--case", metavar="N", min=1, max=4, help="A case of the virtual rig instead of a scene file.")
]
_TROCHLEAE = "normal|A|B|C|D"
# Whether scene files may use files outside their folders (--allow-outside); the program sets it before each command.
allow_outside: ContextVar[bool] = ContextVar("allow_outside", default=False)
# Plausibility limits set by name (--allow); the program sets them too.
limits: ContextVar[Mapping[str, float]] = ContextVar("limits", default=MappingProxyType({}))
_CONTACTS = "P2|P4|P5|spline|CM|FM|volume"


def _complete_contact(incomplete: str) -> list[str]:
    """Names of contacts that start with the typed text, for shell completion."""
    return [name for name in _CONTACTS.split("|") if name.lower().startswith(incomplete.lower())]


ContactOption = Annotated[
    str | None,
    Option(
        "--contact",
        metavar="NAME",
        autocompletion=_complete_contact,
        help="P2, P4, P5 (default) or spline: a patch fitted to the mesh; with --case also meshes: CM, FM, volume.",
    ),
]


def seconds(text: str) -> float:
    """Parses a time step such as "0.0005" [s] or "0.5 ms"; InputError for other text."""
    return amount(text, "s", "--dt")


StepOption = Annotated[
    float | None,
    Option(
        "--dt",
        metavar="SECONDS",
        parser=seconds,
        help='Longest time step [s], or "0.5 ms". Default: 0.001, or shorter if the estimated error requires it.',
    ),
]
ToleranceOption = Annotated[
    str | None,
    Option("--tolerance", metavar='"0.05 mm"|"0.5 N"', help="Instead of --dt: the longest step with a smaller error."),
]


@dataclass(frozen=True)
class Chosen:
    """A scene, and the name of its contact if known."""

    scene: Scene
    contact: str | None
    button: SphereFit | None = None  # sphere of the button, if it was fitted to a mesh
    side_as_given: str = ""  # as in `LoadedScene`


def chosen_scene(
    scene: Path | None,
    case: int | None,
    contact: str | None,
    motion: Path | None = None,
    rate: float | None = None,
    *,
    natural: str | None = None,
    activity: str | None = None,
) -> Chosen:
    """Loads the scene file, the rig's case or the natural knee, optionally with another contact or motion.

    Raises InputError if that is not possible.
    """
    given = [
        name for name, value in (("a scene file", scene), ("--case", case), ("--knee", natural)) if value is not None
    ]
    if len(given) != 1:
        found = f"both {' and '.join(given)}" if given else "neither a scene file nor --case"
        raise InputError(f"{found} given", expected="one of them", remedy="pftwin simulate --case 1 -o case1.nc")
    if natural is not None:
        return _natural(natural, activity, contact, motion)
    if activity is not None:
        raise InputError(
            "given without --knee", where="--activity", expected="--knee as well: only its motion has activities"
        )
    if contact is not None:
        from pftwin.rig.contacts import ON_MESHES, parse_contact

        contact = parse_contact(contact)
        if scene is not None and contact in ON_MESHES:
            raise InputError(
                f"{contact} given for a scene file",
                where="--contact",
                expected="a polynomial or spline",
                remedy="meshes belong to the rig's cases: pftwin simulate --case 1 --contact FM -o case1.nc",
            )
    start_computing()
    if scene is not None:
        from pftwin.files.scene_file import load_scene_file

        with spinner(f"reading {scene}"):
            own: dict[str, Any] = {"allow_outside": allow_outside.get(), "limits": limits.get()}
            loaded = load_scene_file(scene, contact=contact, motion=motion, rate=rate, **own)
        for note in loaded.notes:
            tell(note, "dim")
        return Chosen(loaded.scene, contact or _contact(loaded.scene), loaded.button, loaded.side_as_given)
    from pftwin import rig

    if motion is not None:
        raise InputError("given with --case", where="--motion", expected="a scene file")
    assert case is not None
    with spinner(f"preparing case {case} of the virtual rig"):
        name = contact or "P5"
        return Chosen(rig.case(case, contact=name), name)


def _natural(trochlea: str, activity: str | None, contact: str | None, motion: Path | None) -> Chosen:
    """Makes the natural knee; InputError for an unknown trochlea or activity and for options that do not apply."""
    if trochlea not in _TROCHLEAE.split("|"):
        raise InputError(f"found {trochlea!r}", where="--knee", expected=f"one of: {_TROCHLEAE.replace('|', ', ')}")
    for option, value in (("--contact", contact), ("--motion", motion)):
        if value is not None:
            raise InputError("given with --knee", where=option, expected="a scene file or --case")
    start_computing()
    from pftwin import rig

    with spinner("making the natural knee"):
        anatomy = rig.Anatomy() if trochlea == "normal" else rig.Anatomy.dejour(trochlea)
        return Chosen(rig.knee(anatomy, activity=activity or "squat"), None)


@dataclass(frozen=True)
class SceneOptions:
    """Options that select the scene of a command; see `on_scene`."""

    scene: SceneArgument = None
    case: CaseOption = None
    natural: Annotated[
        str | None,
        Option(
            "--knee",
            metavar=_TROCHLEAE,
            help="The natural knee instead of a scene file: normal, or with a trochlea of Dejour type A to D.",
        ),
    ] = None
    activity: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="Activity of the natural knee: squat (the default), or extension, seated against a weight at the"
            " ankle.",
        ),
    ] = None
    contact: ContactOption = None

    def load(self) -> Chosen:
        """Loads the scene; InputError if it cannot be loaded."""
        return chosen_scene(self.scene, self.case, self.contact, natural=self.natural, activity=self.activity)


@dataclass(frozen=True)
class RecordingOptions(SceneOptions):
    """`SceneOptions` plus another recording of the same knee."""

    motion: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Another recording of the same knee, used instead of the scene's: poses or markers of the same names.",
        ),
    ] = None
    rate: Annotated[
        float | None, Option(metavar="HZ", min=1e-3, help="Its frame rate, if its time column counts frames.")
    ] = None

    def load(self) -> Chosen:
        """Loads the scene; InputError if it cannot be loaded."""
        if self.rate is not None and self.motion is None:
            raise InputError("a rate without --motion", where="--rate", expected="both")
        made_up = {"natural": self.natural, "activity": self.activity}
        return chosen_scene(self.scene, self.case, self.contact, self.motion, self.rate, **made_up)


@dataclass(frozen=True)
class TrialsOptions:
    """Options that select one or several trials of one knee."""

    scene: Annotated[
        list[Path] | None,
        Argument(metavar="[SCENE.toml]...", help="Scene file, or files of several trials of one knee."),
    ] = None
    case: Annotated[
        list[int] | None,
        Option(metavar="N", min=1, max=4, help="A case of the virtual rig instead of scene files; may be repeated."),
    ] = None
    contact: ContactOption = None

    def load(self) -> list[Chosen]:
        """Loads the scenes; InputError if one cannot be loaded."""
        files, cases = self.scene or [], self.case or []
        if files and cases:
            raise InputError("both scene files and --case given", expected="trials of one knee")
        if repeated := [str(each) for each in (*files, *cases) if (*files, *cases).count(each) > 1]:
            raise InputError(f"{repeated[0]} is named twice", expected="each trial once")
        trials = [*((path, None) for path in files), *((None, number) for number in cases)]
        trials = trials or [(None, None)]  # its error reports what is missing
        return [chosen_scene(path, number, self.contact) for path, number in trials]


@dataclass(frozen=True)
class RunOptions(SceneOptions):
    """`SceneOptions` plus the options of a simulation."""

    integrator: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="linear_implicit_bdf2 (default), linear_implicit, newmark, quasi_static, symplectic_euler, ali3p"
            " or diffrax:SOLVER.",
        ),
    ] = None
    dt: StepOption = None

    @property
    def method(self) -> Integrator | None:
        """The named integrator, or None; InputError for an unknown one."""
        from pftwin.dynamics.integrator_text import integrator_from_text

        return None if self.integrator is None else integrator_from_text(self.integrator)


def on_scene(command: Callable[..., None]) -> Callable[..., None]:
    """Replaces the argument `knee` of a command by the options of its class, one of the classes above."""
    kind = inspect.signature(command, eval_str=True).parameters["knee"].annotation
    hints = get_type_hints(kind, include_extras=True)
    options = [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=hints[f.name])
        for f in fields(kind)
    ]
    return with_options(command, "knee", options, lambda values: kind(**values))


def simulated(chosen: Chosen, knee: RunOptions, tolerance: str | None = None) -> tuple[Result, float]:
    """Simulates a scene; returns the result, timed without compilation, and the time of the first run with it [s].

    Warns if contact leaves the spherical part of a fitted button.
    """
    import time

    from pftwin.dynamics.simulate import simulate

    scene, began = chosen.scene, time.perf_counter()
    options: dict[str, Any] = {"integrator": knee.method, "dt": knee.dt, "tolerance": tolerance}
    with progress(f"compiling and simulating {scene.name}") as shown:
        result = simulate(scene, **options, progress=shown)
    first = time.perf_counter() - began
    if tolerance is None:  # with a tolerance, the returned run is not the first one, which compiles
        with progress(f"timing {scene.name}") as shown:
            result = simulate(scene, **options, progress=shown)
    if chosen.button is not None:
        from pftwin.results.button_cap import check_cap

        check_cap(result, chosen.button)
    return result, first


def _contact(scene: Scene) -> str | None:
    """The name of the contact: that of the patch, or the method of mesh contact."""
    from pftwin.geometry.patch.fit import name_of

    method = "" if scene.contact is None else scene.contact.method
    return method or (None if scene.surface is None else name_of(scene.surface))
