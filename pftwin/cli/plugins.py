"""Commands and options that installed packages bring to the program, by entry points.

[project.entry-points."pftwin.commands"]
my_package = "my_package.cli:COMMANDS"          # a sequence of `Command`

[project.entry-points."pftwin.scene_changes"]
my_package = "my_package.cli:with_my_options"   # see `with_scene_changes`
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from typing import Annotated, Any, NamedTuple

from typer import Context, Option

from pftwin.base.errors import InputError
from pftwin.cli.terminal import tell

COMMANDS, SCENE_CHANGES = "pftwin.commands", "pftwin.scene_changes"
PANELS = ("Start", "Simulate", "Fit", "Treat", "Look", "Check", "Exchange")  # in this order; further ones follow


class Job(NamedTuple):
    """Something that people come for: `pftwin` alone shows it above all commands."""

    words: str
    example: str  # a line to copy, which fits a terminal of 80 columns

    @property
    def markdown(self) -> str:
        """For the help; two blanks end a line."""
        return f"{self.words}:  \n`{self.example}`"


class Command(NamedTuple):
    """A command of the program."""

    name: str
    run: Callable[..., None]
    line: str  # of the help: with the name it fits a terminal of 80 columns
    panel: str
    place: int  # in its panel
    job: Job | None = None


def installed_commands() -> list[Command]:
    """All commands that installed packages bring, in the order of the help; warns of any that cannot be loaded."""
    found = [command for listed in _loaded(COMMANDS) for command in listed]
    panels = list(dict.fromkeys([*PANELS, *(c.panel for c in found)]))
    return sorted(found, key=lambda c: (panels.index(c.panel), c.place))


def with_options(
    command: Callable[..., Any],
    argument: str,
    options: Sequence[inspect.Parameter],
    made: Callable[[dict[str, Any]], Any],
) -> Callable[..., Any]:
    """Gives a command options in the place of one of its arguments.

    Args:
        command: has an argument of that name.
        argument: the name.
        options: keyword parameters, annotated for typer; the help lists them in the argument's place.
        made: the argument, from the options' values by name.
    """
    signature = inspect.signature(command, eval_str=True)

    @functools.wraps(command)
    def run(*arguments: Any, **given: Any) -> Any:
        values = {p.name: given.pop(p.name, p.default) for p in options}
        return command(*arguments, **given, **{argument: made(values)})

    own = list(signature.parameters.values())
    place = next(i for i, p in enumerate(own) if p.name == argument)
    parameters = [*own[:place], *options, *own[place + 1 :]]
    run.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore[reportAttributeAccessIssue]
    return run


def with_former_names(names: Mapping[str, str]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Lets options of a command be written by the names that they once had, which no help shows.

    Args:
        names: the former name of an option by the command's argument, as in {"half_width": "--half-width-mm"}.

    Returns:
        A decorator. Where both are written, the command refuses them with an InputError.
    """

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        signature = inspect.signature(command, eval_str=True)
        asking = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=Context)

        @functools.wraps(command)
        def run(*arguments: Any, **given: Any) -> Any:
            context = given.pop("context")
            for name, former in names.items():
                if (written := given.pop(f"former_{name}", None)) is None:
                    continue
                if context.get_parameter_source(name).name == "COMMANDLINE":
                    flag = next(p.opts[0] for p in context.command.params if p.name == name)
                    raise InputError(f"{former} and {flag} given", expected="one of them: it is the same option")
                given[name] = written
            return command(*arguments, **given)

        hidden = [
            asking.replace(
                name=f"former_{name}",
                default=None,
                annotation=Annotated[
                    signature.parameters[name].annotation.__origin__ | None, Option(former, hidden=True)
                ],
            )
            for name, former in names.items()
        ]
        parameters = [*signature.parameters.values(), *hidden, asking]
        run.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore[reportAttributeAccessIssue]
        return run

    return decorated


def with_scene_changes(command: Callable[..., None]) -> Callable[..., None]:
    """Gives a command the options by which installed packages change its scene.

    The command has an argument `change`, a function from a scene to a scene. An entry point takes the command and
    returns it with options of its own in that argument's place. Without any, the argument is left out.
    """
    for decorate in _loaded(SCENE_CHANGES):
        return decorate(command)
    return with_options(command, "change", [], lambda values: None)


def _loaded(group: str) -> Iterator[Any]:
    for point in entry_points(group=group):
        try:
            yield point.load()
        except Exception as error:  # another package's mistake must not take the program down
            tell(
                f"warning: the entry point {point.name!r} ({point.value}) of {group} cannot be loaded: {error}",
                "yellow",
            )
