"""Errors for people: which file, line or field; what was found; what was expected; what to do."""

from __future__ import annotations


class PftwinWarning(UserWarning):
    """Something in the input deserves attention, but the answer stands."""


class PftwinError(Exception):
    """Base of every error that pftwin raises on purpose; its text is meant for the user."""


class InputError(PftwinError, ValueError):
    """Input that cannot give a right answer.

    Args:
        problem: what was found, in one sentence.
        where: the file, and within it the line or field ("walk.trc, line 12"); or the argument's name.
        expected: what would have been right.
        remedy: what the user can do about it.
    """

    def __init__(
        self, problem: str, *, where: object = None, expected: str | None = None, remedy: str | None = None
    ) -> None:
        self.problem, self.where, self.expected, self.remedy = problem, where, expected, remedy
        text = f"{where}: {problem}" if where is not None else problem
        for lead, part in (("expected", expected), ("try", remedy)):
            if part:
                text = f"{text.rstrip('.')}; {lead}: {part}"
        super().__init__(text)


class OutputError(PftwinError, OSError):
    """A result that cannot be written where it was asked for."""


class MissingExtraError(PftwinError, ImportError):
    """A feature whose optional package is not installed.

    Args:
        package: the package that is missing.
        extra: the extra of pftwin that brings it.
        feature: what needs it.
    """

    def __init__(self, package: str, *, extra: str, feature: str) -> None:
        super().__init__(f"{feature} needs the package {package!r}; try: python -m pip install 'pftwin[{extra}]'")
