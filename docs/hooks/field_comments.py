"""Fields of classes say in a comment what they are and in which unit: the reference takes it over as a table."""

from __future__ import annotations

from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """Adds to a class's text the section "Attributes", from the comments at the ends of its fields' lines."""

    def on_class(self, *, cls: Any, **_: Any) -> None:
        """Looks at the class's own fields; constants of the class and names with an underscore are left out."""
        fields = [a for a in cls.members.values() if _is_field(a)]
        if not fields or cls.docstring is None or "\nArgs:\n" in cls.docstring.value:  # told there already
            return
        lines = cls.parent.lines_collection[cls.filepath] if cls.filepath else []
        table = [f"    {a.name}: {_comment(lines, a)}" for a in fields]
        cls.docstring.value = "\n".join([cls.docstring.value.rstrip(), "", "Attributes:", *table])


def _is_field(member: Any) -> bool:
    if not member.is_attribute or member.is_alias or member.name.startswith("_") or member.annotation is None:
        return False
    return not str(member.annotation).startswith("ClassVar") and "property" not in member.labels


def _comment(lines: list[str], field: Any) -> str:
    """What stands behind the # where the field's statement ends; a field without comment has none."""
    _, mark, text = lines[(field.endlineno or field.lineno) - 1].partition("  # ")
    return text.strip() if mark else ""
