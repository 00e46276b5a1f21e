"""Writes the page of scene files from the models that read them: every field, its unit, kind and default."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

from pydantic_core import PydanticUndefined
from spelled_types import sections_of, spelled

from pftwin.files.scene_file import loading
from pftwin.files.scene_file.json_schema import scene_json_schema
from pftwin.files.scene_file.registry import EFFECTS
from pftwin.files.scene_file.section import ONE_OR_MANY, Section

PAGE = "scene_file.md"
SCHEMA_FILE = f"scene-{loading.SCHEMA}.schema.json"
_UNIT = re.compile(r"\s*\[(-|deg|s|m|kg|kg m\^2|m/s|m/s\^2|s/m|Hz|MPa|samples|N[^\]]*)\]")
_HEADER = "| field | unit | kind | default | meaning |\n|---|---|---|---|---|"
_TAG = "tells this table from others in its place"
_HEAD = """# Scene files, field by field

A scene file is TOML. `pftwin init knee` writes a commented one that runs; [bring your own knee](bring_your_own_knee.md)
explains one. This page is made from the models that read the file, so it has every field there is and no other.

- **Lengths.** A field whose name ends in `_m` may be written with `_mm` instead, in millimetres: `radius_mm = 22`.
  What is per metre may be per millimetre likewise: `stiffness_N_per_mm = 0.156` is 156 N/m.
- **Strict.** Unknown fields, text in place of numbers, NaN and infinity are refused, with file, line and field.
- **Frames** are anatomical unless `[axes]` says otherwise: x proximal, y lateral, z anterior
  ([conventions](conventions.md)). Quaternions are (w, x, y, z).
- **Groups.** "or a list" means one value for all members of a group, or one for each.
- **Relative paths** start at the folder of the scene file. Files lie in it or below; a scene that names others, by
  `..`, by an absolute path or by a link, is refused unless you trust it and say so, by
  `pftwin --allow-outside COMMAND ...` or `load_scene(..., allow_outside=True)`.
- A table may be written `[contact]`, or, where there are several, `[[contact]]`.
- **JSON Schema.** [scene-1.schema.json](scene-1.schema.json) says the same to programs: save it beside
  the scene, and with a first line `#:schema scene-1.schema.json` an editor that knows TOML checks the scene while it
  is typed. Its number is that of `schema = 1`. `pftwin.files.scene_file.json_schema.scene_json_schema()` makes it,
  with effects of your own where there are any.
"""
_PARTS = (
    ("## The file itself", "What stands at the top, before any table.", ("",)),
    ("## Bodies and motion", "", ("patella", "motion", "femur", "tibia", "axes", "measured", "bones")),
    ("## Effects", "What acts on the patella. A scene needs at least one of them.", tuple(e.kind for e in EFFECTS)),
)


def on_files(files: Any, config: Any) -> Any:
    """Adds the page, and the JSON Schema beside it."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, PAGE, content=reference()))
    files.append(File.generated(config, SCHEMA_FILE, content=json.dumps(scene_json_schema(), indent=1)))
    return files


def reference() -> str:
    """The page as Markdown."""
    where = tables()
    firsts = Counter(paths[0] for paths in where.values())
    out, written = [_HEAD], set()
    for title, words, tops in _PARTS:
        out += [title, words] if words else [title]
        for model, paths in where.items():
            if paths[0].split(".")[0] in tops:
                out.append(_table(model, paths, alone=firsts[paths[0]] == 1))
                written.add(model)
    left_over = set(where) - written
    if left_over:
        raise ValueError(f"tables in no part of the page: {sorted(m.__name__ for m in left_over)}")
    return "\n\n".join(out) + "\n"


def tables() -> dict[type[Section], list[str]]:
    """Every table that a file can have, with the dotted names of the places where it can stand, "" for the file."""
    found: dict[type[Section], list[str]] = {}

    def visit(model: type[Section], path: str) -> None:
        if path in found.setdefault(model, []):
            return
        found[model].append(path)
        for name, annotation in _fields(model):
            for inner in sections_of(annotation):
                visit(inner, f"{path}.{name}" if path else name)

    visit(loading.scene_file_model(), "")
    return found


def anchor(model: type[Section]) -> str:
    """Where a table stands on the page."""
    return re.sub(r"(?<!^)([A-Z])", r"-\1", model.__name__.removesuffix("Section")).lower()


def link(model: type[Section]) -> str:
    """To where a table stands."""
    return f"[{kind(model)}](#{anchor(model)})"


def _fields(model: type[Section]) -> Iterator[tuple[str, Any]]:
    for key, field in model.model_fields.items():
        yield field.alias or key, field.annotation


def _table(model: type[Section], paths: list[str], *, alone: bool) -> str:
    """A heading, what the table is, and a row for each of its fields."""
    parts = [_title(model, paths[0], alone=alone)]
    if model is not loading.scene_file_model():
        parts.append(" ".join((model.__doc__ or "").split()))
    if len(paths) > 1:
        parts.append("Also: " + ", ".join(f"`[{p}]`" for p in paths[1:]) + ".")
    rows = [_row(field.alias or key, field) for key, field in model.model_fields.items()]
    parts.append("\n".join([_HEADER, *rows]))
    return "\n\n".join(parts)


def _title(model: type[Section], path: str, *, alone: bool) -> str:
    if not path:
        return f"### Top level {{#{anchor(model)}}}"
    level = "#" * min(4, 3 + path.count("."))
    return f"{level} `[{path}]`{'' if alone else ': ' + kind(model)} {{#{anchor(model)}}}"


def kind(model: type[Section]) -> str:
    """The table's own name, by which alternatives in one place are told apart."""
    return anchor(model).replace("-", " ")


def _row(name: str, field: Any) -> str:
    description = field.description or _TAG
    unit = _UNIT.search(description)
    if unit:
        description = _UNIT.sub("", description, count=1)
    takes = spelled(field.annotation, field.metadata, link)
    description = description.removeprefix("table: ").removeprefix("table, or several: ")
    if ONE_OR_MANY in field.metadata:
        takes = takes.replace("list of ", "", 1) + ", one or several"
    cells = (f"`{name}`", unit[1] if unit else "", takes, _default(field), description)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(field: Any) -> str:
    if field.is_required():
        return "**required**"
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        raise ValueError(f"no default: {field}")
    if isinstance(value, Section):
        return "its defaults"
    if value is None or value in ([], {}):
        return ""
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], float):
        return _toml(value[0])  # one value for all of a group
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    print(reference())
