"""[[toe_tendon]]: tendons with a toe region, single or in groups."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import Field, model_validator

from pftwin.files.scene_file.effect_tables import Body, EffectSection
from pftwin.files.scene_file.section import NotNegatives, Points, Positives, problem
from pftwin.files.scene_file.setting import Setting
from pftwin.files.scene_file.tendon_table import damping_of, group_leaves, group_size

if TYPE_CHECKING:
    from pftwin.model.effects.tendon import ToeTendon

_FIELDS = (
    "stiffness_N_per_m",
    "slack_length_m",
    "toe_strain",
    "damping_N_s_per_m",
    "damping_time_s",
    "insertion_m",
    "origin_m",
)


class ToeTendonSection(EffectSection):
    """A tendon that is quadratic up to a toe strain, then linear. Lists instead of single values make a group."""

    kind: ClassVar[str] = "toe_tendon"
    body: Body = Field(description="body at the other end")
    stiffness_N_per_m: Positives = Field(description="stiffness K of the linear region [N/m]")
    slack_length_m: Positives = Field(description="slack length L0 [m]")
    toe_strain: Positives = Field(default_factory=lambda: [0.06], description="strain at the toe region's end [-]")
    damping_N_s_per_m: NotNegatives | None = Field(default=None, description="damping c [N s/m]")
    damping_time_s: NotNegatives | None = Field(default=None, description="damping as a time c / K [s], in place of c")
    insertion_m: Points = Field(description="insertion, patella frame [m]")
    origin_m: Points = Field(description="origin, the body's frame [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.damping_N_s_per_m is not None and self.damping_time_s is not None:
            raise problem("both damping_N_s_per_m and damping_time_s are given", expected="one of them")
        group_size(self, *_FIELDS)
        return self

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> ToeTendon:
        """The effect."""
        from pftwin.model.effects.tendon import ToeTendon

        (k, slack, toe, c), (insertion, origin) = group_leaves(
            setting,
            self.body,
            (self.stiffness_N_per_m, self.slack_length_m, self.toe_strain, damping_of(self)),
            self.insertion_m,
            self.origin_m,
        )
        return ToeTendon(k, slack, toe, c, insertion, origin, body=self.body, name=self.label)
