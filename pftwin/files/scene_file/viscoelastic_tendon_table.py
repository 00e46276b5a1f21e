"""[[viscoelastic_tendon]]: tendons that relax, single or in groups."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import Field, model_validator

from pftwin.files.scene_file.effect_tables import Body, EffectSection
from pftwin.files.scene_file.section import NotNegatives, Points, Positives
from pftwin.files.scene_file.setting import Setting
from pftwin.files.scene_file.tendon_table import group_leaves, group_size

if TYPE_CHECKING:
    from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon

_FIELDS = (
    "stiffness_N_per_m",
    "maxwell_stiffness_N_per_m",
    "relaxation_time_s",
    "slack_length_m",
    "insertion_m",
    "origin_m",
)


class ViscoelasticTendonSection(EffectSection):
    """A standard linear solid: K relaxed, K + K1 pulled at once. Lists instead of single values make a group."""

    kind: ClassVar[str] = "viscoelastic_tendon"
    body: Body = Field(description="body at the other end")
    stiffness_N_per_m: Positives = Field(description="stiffness K when relaxed [N/m]")
    maxwell_stiffness_N_per_m: NotNegatives = Field(description="K1, what it is stiffer by when pulled at once [N/m]")
    relaxation_time_s: Positives = Field(description="time tau in which the tension relaxes when held [s]")
    slack_length_m: Positives = Field(description="slack length L0 [m]")
    insertion_m: Points = Field(description="insertion, patella frame [m]")
    origin_m: Points = Field(description="origin, the body's frame [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        group_size(self, *_FIELDS)
        return self

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> ViscoelasticTendon:
        """The effect."""
        from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon

        lists = (self.stiffness_N_per_m, self.maxwell_stiffness_N_per_m, self.relaxation_time_s, self.slack_length_m)
        (k, maxwell, tau, slack), (insertion, origin) = group_leaves(
            setting, self.body, lists, self.insertion_m, self.origin_m
        )
        return ViscoelasticTendon(k, maxwell, tau, slack, insertion, origin, body=self.body, name=self.label)
