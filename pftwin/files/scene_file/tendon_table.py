"""[[tendon]]: linear spring-dampers, single or in groups."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.scene_file.effect_tables import Body, EffectSection
from pftwin.files.scene_file.section import NotNegatives, Points, Positives, problem
from pftwin.files.scene_file.setting import Setting
from pftwin.model.effects.tendon import Tendon


class TendonSection(EffectSection):
    """A tendon: F = K (L - L0) + c dL/dt, never pushing. Lists instead of single values make a group."""

    kind: ClassVar[str] = "tendon"
    body: Body = Field(description="body at the other end")
    stiffness_N_per_m: Positives = Field(description="stiffness K [N/m]")
    slack_length_m: Positives = Field(description="slack length L0 [m]")
    damping_N_s_per_m: NotNegatives | None = Field(default=None, description="damping c [N s/m]")
    damping_time_s: NotNegatives | None = Field(default=None, description="damping as a time c / K [s], in place of c")
    insertion_m: Points = Field(description="insertion, patella frame [m]")
    origin_m: Points = Field(description="origin, the body's frame [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.damping_N_s_per_m is not None and self.damping_time_s is not None:
            raise problem("both damping_N_s_per_m and damping_time_s are given", expected="one of them")
        group_size(self, "stiffness_N_per_m", "slack_length_m", "damping_N_s_per_m", "damping_time_s", *_ENDS)
        return self

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> Tendon:
        """The effect."""
        lists = (self.stiffness_N_per_m, self.slack_length_m, damping_of(self))
        (k, slack, c), (insertion, origin) = group_leaves(setting, self.body, lists, self.insertion_m, self.origin_m)
        return Tendon(k, slack, c, insertion, origin, body=self.body, name=self.label)


_ENDS = ("insertion_m", "origin_m")


def damping_of(section: Any) -> list[float]:
    """Damping c [N s/m], given as it is or as a time c / K; 0 by default."""
    if section.damping_time_s is None:
        return section.damping_N_s_per_m or [0.0]
    return list(np.asarray(section.stiffness_N_per_m) * np.asarray(section.damping_time_s))


def group_leaves(
    setting: Setting, body: str, lists: Sequence[list[float]], insertion: list[list[float]], origin: list[list[float]]
) -> tuple[list[Scalar], list[Vec3]]:
    """Numbers and both ends of a group's members, with the members' axis in front; of a single one without it."""
    ends = setting.points("patella", insertion), setting.points(body, origin)
    n = max(len(a) for a in (*lists, *ends))
    scalars = [number(member_values(np.asarray(a), n)) for a in lists]
    return scalars, [vector(member_values(e, n)) for e in ends]


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
