"""What the tables of all effects share."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Literal

from pydantic import Field

from pftwin.files.scene_file.section import Name, Section
from pftwin.files.scene_file.setting import Setting
from pftwin.model.effects.base import Effect

Body = Literal["femur", "tibia", "ground"]


class EffectSection(Section):
    """A table that becomes an effect. `kind` is the table's name; effects go by it where they have no name."""

    kind: ClassVar[str]
    name: Name | None = Field(default=None, description="name of the effect in results; the table's name by default")

    @property
    def label(self) -> str:
        """The effect's name."""
        return self.name or self.kind

    @abstractmethod
    def build(self, setting: Setting, at: tuple[str | int, ...]) -> Effect:
        """The effect; `at` is the table's place in the file.

        Raises:
            InputError: files that cannot be used, groups of unlike lengths.
        """
