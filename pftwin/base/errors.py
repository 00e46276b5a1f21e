"""Exceptions and warnings whose messages say where, what was found, what was expected, and what to do."""

from __future__ import annotations

import re

_UNREADABLE = re.compile(r"\S{300,}")  # a name or value of a broken file, which a message shortens


class PftwinWarning(UserWarning):
    """The input is questionable, but the result is valid."""


class PftwinError(Exception):
    """Base class of all errors that pftwin raises deliberately; the message is for the user."""


class InputError(PftwinError, ValueError):
    """Invalid input.

    Args:
        problem: what was found, in one sentence.
        where: the file and its line or field ("walk.trc, line 12"), or the name of the argument.
        expected: what would be valid.
        remedy: what the user can do.
    """

    def __init__(
        self, problem: str, *, where: object = None, expected: str | None = None, remedy: str | None = None
    ) -> None:
        self.problem, self.where, self.expected, self.remedy = problem, where, expected, remedy
        said = _UNREADABLE.sub(lambda long: f"{long[0][:60]}... ({len(long[0])} characters)", problem)
        text = f"{where}: {said}" if where is not None else said
        for label, part in (("expected", expected), ("try", remedy)):
            if part:
                text = f"{text.rstrip('.')}; {label}: {part}"
        super().__init__(text)


class OutputError(PftwinError, OSError):
    """A file or folder cannot be written at the requested path."""


class MissingExtraError(PftwinError, ImportError):
    """An optional package that a feature needs is not installed.

    Args:
        package: name of the missing package.
        extra: pftwin's extra that installs it.
        feature: name of the feature.
    """

    def __init__(self, package: str, *, extra: str, feature: str) -> None:
        super().__init__(f"{feature} needs the package {package!r}; try: python -m pip install 'pftwin[{extra}]'")
