"""[[tendon]], [[toe_tendon]] and [[viscoelastic_tendon]]: lines with a spring and a damper, single or in groups."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.scene_file.effect_tables import Body, EffectSection, Setting
from pftwin.files.scene_file.section import NotNegatives, Points, Positives, problem
from pftwin.model.effects.tendon import Tendon

if TYPE_CHECKING:
    from pftwin.model.effects.tendon import ToeTendon
    from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon


class _LineSection(EffectSection):
    """What lines of force have in common. Lists instead of single values make a group."""

    lists: ClassVar[tuple[str, ...]]  # fields with one value for each member, besides the two ends
    body: Body = Field(description="body at the other end")
    stiffness_N_per_m: Positives = Field(description="stiffness K [N/m]")
    slack_length_m: Positives = Field(description="slack length L0 [m]")
    insertion_m: Points = Field(description="insertion, patella frame [m]")
    origin_m: Points = Field(description="origin, the body's frame [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        group_size(self, *self.lists, "insertion_m", "origin_m")
        return self

    def leaves(self, setting: Setting, *lists: list[float]) -> tuple[list[Scalar], list[Vec3]]:
        """Numbers and both ends of the members, with the members' axis in front; of a single one without it."""
        ends = setting.points("patella", self.insertion_m), setting.points(self.body, self.origin_m)
        n = max(len(a) for a in (*lists, *ends))
        scalars = [number(member_values(np.asarray(a), n)) for a in lists]
        return scalars, [vector(member_values(e, n)) for e in ends]


class _DampedSection(_LineSection):
    """A line with a viscous damper beside its spring."""

    damping_N_s_per_m: NotNegatives | None = Field(default=None, description="damping c [N s/m]")
    damping_time_s: NotNegatives | None = Field(default=None, description="damping as a time c / K [s], in place of c")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.damping_N_s_per_m is not None and self.damping_time_s is not None:
            raise problem("both damping_N_s_per_m and damping_time_s are given", expected="one of them")
        group_size(self, *self.lists, "insertion_m", "origin_m")
        return self

    @property
    def damping(self) -> list[float]:
        """Damping c [N s/m]; 0 by default."""
        if self.damping_time_s is None:
            return self.damping_N_s_per_m or [0.0]
        return list(np.asarray(self.stiffness_N_per_m) * np.asarray(self.damping_time_s))


class TendonSection(_DampedSection):
    """A tendon: F = K (L - L0) + c dL/dt, never pushing. Lists instead of single values make a group."""

    kind: ClassVar[str] = "tendon"
    lists: ClassVar[tuple[str, ...]] = ("stiffness_N_per_m", "slack_length_m", "damping_N_s_per_m", "damping_time_s")

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> Tendon:
        """The effect."""
        (k, slack, c), (insertion, origin) = self.leaves(
            setting, self.stiffness_N_per_m, self.slack_length_m, self.damping
        )
        return Tendon(k, slack, c, insertion, origin, body=self.body, name=self.label)


class ToeTendonSection(_DampedSection):
    """A tendon that is quadratic up to a toe strain, then linear. Lists instead of single values make a group."""

    kind: ClassVar[str] = "toe_tendon"
    lists: ClassVar[tuple[str, ...]] = (*TendonSection.lists, "toe_strain")
    stiffness_N_per_m: Positives = Field(description="stiffness K of the linear region [N/m]")
    toe_strain: Positives = Field(default_factory=lambda: [0.06], description="strain at the toe region's end [-]")

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> ToeTendon:
        """The effect."""
        from pftwin.model.effects.tendon import ToeTendon

        (k, slack, toe, c), (insertion, origin) = self.leaves(
            setting, self.stiffness_N_per_m, self.slack_length_m, self.toe_strain, self.damping
        )
        return ToeTendon(k, slack, toe, c, insertion, origin, body=self.body, name=self.label)


class ViscoelasticTendonSection(_LineSection):
    """A standard linear solid: K relaxed, K + K1 pulled at once. Lists instead of single values make a group."""

    kind: ClassVar[str] = "viscoelastic_tendon"
    lists: ClassVar[tuple[str, ...]] = (
        "stiffness_N_per_m",
        "maxwell_stiffness_N_per_m",
        "relaxation_time_s",
        "slack_length_m",
    )
    stiffness_N_per_m: Positives = Field(description="stiffness K when relaxed [N/m]")
    maxwell_stiffness_N_per_m: NotNegatives = Field(description="K1, what it is stiffer by when pulled at once [N/m]")
    relaxation_time_s: Positives = Field(description="time tau in which the tension relaxes when held [s]")

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> ViscoelasticTendon:
        """The effect."""
        from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon

        lists = (self.stiffness_N_per_m, self.maxwell_stiffness_N_per_m, self.relaxation_time_s, self.slack_length_m)
        (k, maxwell, tau, slack), (insertion, origin) = self.leaves(setting, *lists)
        return ViscoelasticTendon(k, maxwell, tau, slack, insertion, origin, body=self.body, name=self.label)


def group_size(section: Any, *names: str) -> int:
    """How many members a group has: every field has one value for all, or one for each."""
    sizes = {name: len(value) for name in names if (value := getattr(section, name)) is not None}
    n = max(sizes.values())
    if odd := [f"{name} has {k}" for name, k in sizes.items() if k not in (1, n)]:
        longest = max(sizes, key=lambda name: sizes[name])
        raise problem(
            f"{', '.join(odd)} values and {longest} has {n}", expected="one value for all members, or one for each"
        )
    return n


def member_values(values: np.ndarray, n: int) -> np.ndarray:
    """Values of each of n members along the first axis; without that axis where there is only one."""
    return values[0] if n == 1 else np.broadcast_to(values, (n, *values.shape[1:]))
