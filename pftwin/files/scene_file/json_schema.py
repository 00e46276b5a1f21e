"""JSON Schema of scene files for editors and other programs, generated from the models that read the files.

It covers tables, fields, types and bounds. The reader also checks the consistency of fields, the files that are
referred to, and the resulting scene.
"""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from pftwin.files.scene_file.loading import SCHEMA, scene_file_model
from pftwin.files.scene_file.section import IN_PLACE_OF_LISTS, other_unit

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_BOUNDS = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")


def scene_json_schema() -> dict[str, Any]:
    """JSON Schema of scene files, with the tables of all registered effects; the version is in its `$id`."""
    made = scene_file_model().model_json_schema(schema_generator=_AsWritten)
    about = {"$schema": DIALECT, "$id": f"urn:pftwin:scene:{SCHEMA}", "title": f"pftwin scene file, schema = {SCHEMA}"}
    return {**about, **{key: value for key, value in made.items() if key not in about}}


class _AsWritten(GenerateJsonSchema):
    """Schema of the input before normalization: fields in millimetres, and single values instead of lists."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False  # names are sufficient

    def function_before_schema(self, schema: Any) -> JsonSchemaValue:
        made = super().function_before_schema(schema)
        if schema["function"]["function"] not in IN_PLACE_OF_LISTS:
            return made
        return {"anyOf": [made["items"], made]}

    def model_schema(self, schema: Any) -> JsonSchemaValue:
        made = super().model_schema(schema)
        fields, needed, rules = made.get("properties", {}), made.get("required", []), []
        for name in list(fields):
            if (other := other_unit(name)) is None:
                continue
            written, factor = other
            fields[written] = _scaled(fields[name], 1 / factor)
            both: JsonSchemaValue = {"required": [name, written]}
            one: JsonSchemaValue = {"oneOf": [{"required": [name]}, {"required": [written]}]}
            rules.append(one if name in needed else {"not": both})
        if rules:
            made["required"] = [name for name in needed if other_unit(name) is None]
            made["allOf"] = rules
        return made


def _scaled(schema: Any, factor: float) -> Any:
    """Schema of the same quantity in a unit that is smaller by a factor; without the default."""
    if isinstance(schema, list):
        return [_scaled(inner, factor) for inner in schema]
    if not isinstance(schema, dict):
        return schema
    fields = {key: value for key, value in schema.items() if key != "default"}
    return {key: factor * value if key in _BOUNDS else _scaled(value, factor) for key, value in fields.items()}
