"""Which package may know which: pftwin knows nothing of fitting, and nothing but a command line knows one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(p.relative_to(ROOT) for package in ("pftwin", "fitting") for p in (ROOT / package).rglob("*.py"))


def imported(text: str) -> Iterator[str]:
    """Modules, and names taken from them, that a source imports anywhere, and that it names for a later import."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module") and node.args:
            yield ast.unparse(node.args[0]).strip("f'\"")


def test_a_source_is_read_to_its_depth() -> None:
    text = "import a.b\ndef f():\n    from c import d\n    import_module(f'e.{x}')\n"
    assert set(imported(text)) == {"a.b", "c.d", "e.{x}"}


@pytest.mark.parametrize("file", [f for f in FILES if f.parts[0] == "pftwin"], ids=str)
def test_pftwin_does_not_know_fitting(file: Path) -> None:
    text = (ROOT / file).read_text(encoding="utf-8")
    assert not [name for name in imported(text) if name.partition(".")[0] == "fitting"]


@pytest.mark.parametrize("file", [f for f in FILES if f.parts[1] not in ("cli", "__main__.py")], ids=str)
def test_nothing_but_a_command_line_knows_one(file: Path) -> None:
    text = (ROOT / file).read_text(encoding="utf-8")
    assert not [name for name in imported(text) if f"{name}.".startswith(("pftwin.cli.", "fitting.cli."))]
