"""Commands and options that installed packages add to the program through entry points.

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
PANELS = ("Start", "Simulate", "Fit", "Treat", "Look", "Check", "Exchange")  # order of the help; others follow


class Job(NamedTuple):
    """A common task, which `pftwin` without arguments shows above the commands."""

    words: str
    example: str  # command line to copy, which fits 80 columns

    @property
    def markdown(self) -> str:
        """The task as Markdown for the help; two spaces end a line."""
        return f"{self.words}:  \n`{self.example}`"


class Command(NamedTuple):
    """A command of the program."""

    name: str
    run: Callable[..., None]
    line: str  # description in the help, which fits 80 columns with the name
    panel: str  # panel of the help
    place: int  # order in its panel
    job: Job | None = None


def installed_commands() -> list[Command]:
    """Returns the commands of all installed packages in the order of the help; warns if any cannot be loaded."""
    found = [command for listed in _loaded(COMMANDS) for command in listed]
    panels = list(dict.fromkeys([*PANELS, *(c.panel for c in found)]))
    return sorted(found, key=lambda c: (panels.index(c.panel), c.place))


def with_options(
    command: Callable[..., Any],
    argument: str,
    options: Sequence[inspect.Parameter],
    made: Callable[[dict[str, Any]], Any],
) -> Callable[..., Any]:
    """Replaces an argument of a command by options.

    Args:
        command: the command, which has the argument.
        argument: name of the argument.
        options: keyword parameters, annotated for typer; the help lists them in place of the argument.
        made: function that makes the argument from the options' values by name.
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
    """Accepts former names of a command's options, which the help does not show.

    Args:
        names: former option name by argument name, as in {"half_width": "--half-width-mm"}.

    Returns:
        A decorator. The command raises InputError if both names of an option are given.
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
    """Adds to a command the options with which an installed package changes its scene.

    The command has an argument `change`, a function from a scene to a scene. An entry point takes the command and
    returns it with its own options in place of that argument. Without an entry point, the argument is removed.
    """
    for decorate in _loaded(SCENE_CHANGES):
        return decorate(command)
    return with_options(command, "change", [], lambda values: None)


def _loaded(group: str) -> Iterator[Any]:
    for point in entry_points(group=group):
        try:
            yield point.load()
        except Exception as error:  # an error of another package must not break the program
            tell(
                f"warning: the entry point {point.name!r} ({point.value}) of {group} cannot be loaded: {error}",
                "yellow",
            )
