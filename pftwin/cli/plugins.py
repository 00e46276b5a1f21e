"""Commands and options that installed packages bring to the program, by entry points.

[project.entry-points."pftwin.commands"]
my_package = "my_package.cli:COMMANDS"          # a sequence of `Command`

[project.entry-points."pftwin.scene_changes"]
my_package = "my_package.cli:with_my_options"   # see `with_scene_changes`
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import entry_points
from typing import Any, NamedTuple

from pftwin.cli.terminal import tell

COMMANDS, SCENE_CHANGES = "pftwin.commands", "pftwin.scene_changes"
PANELS = ("Start", "Simulate", "Fit", "Treat", "Look", "Check", "Exchange")  # in this order; further ones follow


class Command(NamedTuple):
    """A command of the program."""

    name: str
    run: Callable[..., None]
    line: str  # of the help: with the name it fits a terminal of 80 columns
    panel: str
    place: int  # in its panel


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
