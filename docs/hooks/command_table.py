"""The table of all commands, from the one that `pftwin --help` shows."""

from __future__ import annotations

from typing import Any

from pftwin.cli.program import COMMANDS

PAGE, MARK = "command_line.md", "<!-- table: commands -->"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Puts the table where the page asks for it."""
    return filled(markdown) if page.file.src_uri == PAGE else markdown


def filled(markdown: str) -> str:
    """The page with its table."""
    if MARK not in markdown:
        raise ValueError(f"{PAGE} has no place for its table of commands: {MARK}")
    lines = ["| | command | what for |", "|---|---|---|"]
    before = ""
    for command in COMMANDS:
        lines.append(
            f"| {'' if command.panel == before else command.panel} | `pftwin {command.name}` | {command.line} |"
        )
        before = command.panel
    return markdown.replace(MARK, "\n".join(lines))
