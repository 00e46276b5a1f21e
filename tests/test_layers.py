"""Which room may know which: imports run one way, and nothing but a command line knows one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(p.relative_to(ROOT) for package in ("pftwin", "fitting") for p in (ROOT / package).rglob("*.py"))
# From below to above: a room knows itself and those below it. Files that hold no scene come before the model, scene
# files make scenes, other programs' files take results too.
ROOMS = (
    "base",
    "geometry",
    "files",
    "model",
    "files.scene_file",
    "dynamics",
    "results",
    "files.interchange",
    "rig",
    "studies",
    "cli",
)
# Lazy imports of what is built on top, so that users have it where they look for it.
BACKWARDS = {
    ("pftwin/dynamics/simulate.py", "pftwin.results.result"),  # `simulate` gives a Result
}


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


def test_every_file_is_in_a_room() -> None:
    loose = [f for f in FILES if f.parts[0] == "pftwin" and len(f.parts) == 2]
    assert {f.name for f in loose} == {"__init__.py", "__main__.py"}
    rooms = {f.parts[1] for f in FILES if f.parts[0] == "pftwin" and len(f.parts) > 2}
    assert rooms == {room.partition(".")[0] for room in ROOMS}


def room_of(module: str) -> int:
    """The number of a pftwin module's room; -1 of the package itself."""
    inside = module.partition(".")[2] + "."
    return max(
        (i for i, room in enumerate(ROOMS) if inside.startswith(f"{room}.")), key=lambda i: len(ROOMS[i]), default=-1
    )


@pytest.mark.parametrize("file", [f for f in FILES if f.parts[0] == "pftwin" and len(f.parts) > 2], ids=str)
def test_imports_run_one_way(file: Path) -> None:
    own, wrong = room_of(".".join(file.with_suffix("").parts)), []
    for name in imported((ROOT / file).read_text(encoding="utf-8")):
        above = name.startswith("pftwin.") and room_of(name) > own
        if name.partition(".")[0] == "fitting" or (
            above and (file.as_posix(), name.rpartition(".")[0]) not in BACKWARDS
        ):
            wrong.append(name)
    assert not wrong


def module_of(file: Path) -> str:
    """The module of a file; a package's is its `__init__.py`."""
    return ".".join(file.parent.parts if file.name == "__init__.py" else file.with_suffix("").parts)


def imported_at_once(file: Path, modules: frozenset[str]) -> set[str]:
    """Modules that importing a file imports first, packages around them included; those around itself have begun."""
    own, found = module_of(file), set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:  # not in functions, not for type checkers
        names = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [str(node.module), *(f"{node.module}.{name.name}" for name in node.names)]
        for name in names:
            parts = name.split(".")
            found |= {".".join(parts[:n]) for n in range(1, len(parts) + 1)}
    return {m for m in found & modules if not f"{own}.".startswith(f"{m}.")}


def test_any_module_can_be_imported_first() -> None:
    """No imports run in a circle: which of its modules came first would decide whether it can be closed."""
    modules = frozenset(module_of(f) for f in FILES)
    first = {module_of(f): imported_at_once(f, modules) for f in FILES}
    while free := [m for m, needs in first.items() if not needs]:
        for m in free:
            del first[m]
        for needs in first.values():
            needs.difference_update(free)
    assert not first


@pytest.mark.parametrize("file", [f for f in FILES if f.parts[1] not in ("cli", "__main__.py")], ids=str)
def test_nothing_but_a_command_line_knows_one(file: Path) -> None:
    text = (ROOT / file).read_text(encoding="utf-8")
    assert not [name for name in imported(text) if f"{name}.".startswith(("pftwin.cli.", "fitting.cli."))]


@pytest.mark.parametrize("face", [f for f in FILES if f.name == "__init__.py"], ids=str)
def test_no_name_of_a_face_is_hidden_by_a_module(face: Path) -> None:
    """Importing `package.name` binds the module in its package, where a face that looks names up later is not asked."""
    package = import_module(".".join(face.parent.parts))
    folder = (ROOT / face).parent
    modules = {p.stem for p in folder.glob("*.py")} | {p.parent.name for p in folder.glob("*/__init__.py")}
    meant = {*vars(package).get("_MODULES", ()), *vars(package).get("_PACKAGES", ())}  # faces that give modules say so
    hidden = (modules & {*vars(package).get("__all__", ())}) - meant
    if "__getattr__" in vars(package):
        assert not hidden
    assert not [name for name in hidden if isinstance(getattr(package, name), ModuleType)]
