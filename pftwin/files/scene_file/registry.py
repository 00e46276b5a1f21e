"""Registry of effects' tables in scene files: built-in, from installed packages, and registered by `register_effect`.

A custom effect, `class Band(ElasticLine)`, is read from `[[band]]` after a call of `pftwin.register_effect(Band)`, or
if an installed package declares it as an entry point:

    [project.entry-points."pftwin.effects"]
    band = "my_package:Band"
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import Any

from pftwin.base.errors import InputError
from pftwin.files.scene_file.contact_table import ContactSection
from pftwin.files.scene_file.effect_tables import DampingSection, EffectSection, GravitySection, declared_table
from pftwin.files.scene_file.line_tables import (
    StrandsSection,
    TendonSection,
    ToeTendonSection,
    ViscoelasticTendonSection,
)
from pftwin.files.scene_file.mesh_contact_table import ElasticFoundationSection, MeshContactSection
from pftwin.files.scene_file.tension_table import PrescribedTensionSection
from pftwin.model.effects.base import Effect
from pftwin.model.effects.marker import Marker

EFFECTS: tuple[type[EffectSection], ...] = (
    GravitySection,
    TendonSection,
    ToeTendonSection,
    ViscoelasticTendonSection,
    StrandsSection,
    PrescribedTensionSection,
    ContactSection,
    MeshContactSection,
    ElasticFoundationSection,
    DampingSection,
    declared_table(Marker, words={"point": "position on the patella [m]"}),
)
ENTRY_POINTS = "pftwin.effects"
_registered: dict[str, type[EffectSection]] = {}


def register_effect(effect: type[Effect] | type[EffectSection], kind: str | None = None) -> None:
    """Registers a custom effect, so that scene files can use it.

    Args:
        effect: a class of effects, whose table is generated from the declarations of its fields (`quantity`); or a
            custom table that builds an effect.
        kind: name of the table; by default the class's, in lower case with underscores.

    Raises:
        InputError: a name that is already in use; a field whose declaration is incomplete.
    """
    table = effect if issubclass(effect, EffectSection) else declared_table(effect, kind)
    if any(table.kind == own.kind for own in EFFECTS):
        raise InputError(f"[{table.kind}] is pftwin's own", where="register_effect", expected="another name, by kind=")
    _registered[table.kind] = table


def effect_tables() -> tuple[type[EffectSection], ...]:
    """All registered tables, pftwin's own first."""
    return (*EFFECTS, *{**_installed(), **_registered}.values())


@cache
def _installed() -> dict[str, type[EffectSection]]:
    """Tables of installed packages. Raises InputError for an entry point that cannot be loaded or is not an effect."""
    found = {}
    for point in entry_points(group=ENTRY_POINTS):
        where = f"entry point {point.name!r} of group {ENTRY_POINTS!r}"
        try:
            effect: Any = point.load()
        except Exception as error:
            raise InputError(f"{point.value} cannot be loaded: {error}", where=where) from error
        if not (isinstance(effect, type) and issubclass(effect, Effect | EffectSection)):
            raise InputError(
                f"{point.value} is no effect", where=where, expected="a class derived from pftwin's Effect"
            )
        table = effect if issubclass(effect, EffectSection) else declared_table(effect, point.name)
        found[table.kind] = table
    return found
