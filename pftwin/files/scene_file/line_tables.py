"""[[tendon]], [[toe_tendon]], [[viscoelastic_tendon]] and [[strands]]: elastic lines, single or in groups.

Strands are given in the scene file, or in a separate JSON or CSV file.
"""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

import fnmatch
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.base.leaves import number as leaf
from pftwin.base.leaves import vector
from pftwin.base.text_files import csv_cells, number, read_json, read_lines, refuse_repeated
from pftwin.files.mocap.tables import unknown_name
from pftwin.files.scene_file.effect_tables import (
    Body,
    DeclaredSection,
    EffectSection,
    FieldMapping,
    Setting,
    declared_table,
)
from pftwin.files.scene_file.section import FileName, NotNegatives, Points, Positives, group_size, problem
from pftwin.files.scene_file.wrap_table import WRAP, Wrap, obstacle
from pftwin.model.effects.base import Effect
from pftwin.model.effects.tendon import TOE_STRAIN, StrandGroup, Tendon, ToeTendon

_LINE = {
    "stiffness": "stiffness K",
    "slack_length": "slack length L0",
    "toe_strain": "strain at the end of the toe region",
    "insertion": "insertion, patella frame [m]",
    "origin": "origin, the body's frame [m]",
}


class _DampedSection(DeclaredSection):
    """A line whose damping may also be given as a time."""

    damping_N_s_per_m: NotNegatives = Field(default_factory=lambda: [0.0], description="damping c [N s/m]")
    damping_time_s: NotNegatives | None = Field(default=None, description="damping as a time c / K [s], instead of c")
    if TYPE_CHECKING:
        stiffness_N_per_m: list[float]

    def _check(self) -> None:
        if self.damping_time_s is not None and "damping_N_s_per_m" in self.model_fields_set:
            raise problem("both damping_N_s_per_m and damping_time_s are given", expected="one of them")
        group_size(self, "damping_time_s", *self._mapping.numbers, *self._mapping.points)
        if self.damping_time_s is not None:
            self.damping_N_s_per_m = list(np.asarray(self.stiffness_N_per_m) * np.asarray(self.damping_time_s))


class TendonSection(_DampedSection, declared_table(Tendon, words=_LINE)):
    """A tendon that only pulls: F = K (L - L0) + c dL/dt. Lists instead of single values make a group."""


_TOE = {**_LINE, "stiffness": "stiffness K of the linear region"}


class ToeTendonSection(_DampedSection, declared_table(ToeTendon, words=_TOE, defaults={"toe_strain": TOE_STRAIN})):
    """A tendon that is quadratic up to a toe strain, then linear. Lists instead of single values make a group."""


def _viscoelastic_tendon(**values: Any) -> Effect:
    """Imports the effect only if a scene has it."""
    from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon

    return ViscoelasticTendon(**values)


class ViscoelasticTendonSection(DeclaredSection):
    """A standard linear solid: stiffness K relaxed, K + K1 at once. Lists instead of single values make a group."""

    kind: ClassVar[str] = "viscoelastic_tendon"
    _mapping: ClassVar[FieldMapping] = FieldMapping(
        _viscoelastic_tendon,
        numbers={
            "stiffness_N_per_m": "stiffness",
            "maxwell_stiffness_N_per_m": "maxwell_stiffness",
            "relaxation_time_s": "relaxation_time",
            "slack_length_m": "slack_length",
        },
        points={"insertion_m": ("insertion", "patella"), "origin_m": ("origin", "body")},
        unchanged=["body"],
        obstacles=["wrap"],
    )
    body: Body = Field(description="body at the other end")
    stiffness_N_per_m: Positives = Field(description="relaxed stiffness K [N/m]")
    maxwell_stiffness_N_per_m: NotNegatives = Field(description="additional instantaneous stiffness K1 [N/m]")
    relaxation_time_s: Positives = Field(description="relaxation time tau at constant length [s]")
    slack_length_m: Positives = Field(description="slack length L0 [m]")
    insertion_m: Points = Field(description="insertion, patella frame [m]")
    origin_m: Points = Field(description="origin, the body's frame [m]")
    wrap: Wrap = WRAP


_INLINE = ("stiffness_N_per_strain", "slack_length_m", "insertion_m", "origin_m")
_COLUMNS = ("stiffness_N_per_strain", "slack_length_m", *(f"{e}_{k}_m" for e in ("insertion", "origin") for k in "xyz"))


class StrandsSection(EffectSection):
    """Ligament strands with a toe region (Blankevoort and Huiskes 1991); one value for all or one for each strand."""

    kind: ClassVar[str] = "strands"
    body: Body = Field(description="body at the other end")
    file: FileName | None = Field(default=None, description="JSON or CSV file of strands, instead of the lists")
    select: list[str] = Field(default=["*"], description='names or patterns of the strands to use, such as "PT*"')
    stiffness_N_per_strain: Positives | None = Field(default=None, description="stiffness [N per unit strain]")
    slack_length_m: Positives | None = Field(default=None, description="slack length [m]")
    insertion_m: Points | None = Field(default=None, description="insertion, patella frame [m]")
    origin_m: Points | None = Field(default=None, description="origin, the body's frame [m]")
    toe_strain: Positives = Field(default_factory=lambda: [0.06], description="strain at the end of the toe region [-]")
    damping_time_s: NotNegatives = Field(default_factory=lambda: [0.0], description="damping c of F = k c de/dt [s]")
    wrap: Wrap = WRAP

    def _check(self) -> None:
        given = [name for name in _INLINE if getattr(self, name) is not None]
        if self.file is not None and given:
            raise problem(f"both file and {given[0]} are given", expected="one of them")
        if self.file is None:
            if absent := [name for name in _INLINE if name not in given]:
                raise problem(f"{absent[0]} is missing", expected=f"file, or {', '.join(_INLINE)}")
            group_size(self, *_INLINE, "toe_strain", "damping_time_s")

    def build(self, setting: Setting) -> StrandGroup:
        """The effect."""
        if self.file is None:
            n = group_size(self, *_INLINE, "toe_strain", "damping_time_s")
            stiffness, slack, insertion, origin = (np.asarray(getattr(self, name), np.float64) for name in _INLINE)
        else:
            with setting.naming("file"):
                path = setting.path(self.file)
                found = _selected(read_strands(path, self.body), self.select, self.body, path)
            n, (_, stiffness, slack, insertion, origin) = len(found.names), found
        for label in ("toe_strain", "damping_time_s"):
            if (given := len(getattr(self, label))) not in (1, n):
                where = setting.where(label)
                raise InputError(f"{given} values for {n} strands", where=where, expected=f"1 or {n}")
        k, l0, toe, damping = (
            leaf(np.broadcast_to(v, (n,))) for v in (stiffness, slack, self.toe_strain, self.damping_time_s)
        )
        ends = setting.points("patella", insertion), setting.points(self.body, origin)
        on_patella, on_body = (vector(np.broadcast_to(e, (n, 3))) for e in ends)
        wrap = obstacle(self.wrap, n, setting)
        return StrandGroup(k, l0, toe, damping, on_patella, on_body, self.body, wrap=wrap, name=self.label)


class Strands(NamedTuple):
    """n strands as arrays."""

    names: list[str]
    stiffness: np.ndarray  # (n,) [N per unit strain]
    slack_length: np.ndarray  # (n,) [m]
    insertion: np.ndarray  # (n, 3) patella frame [m]
    origin: np.ndarray  # (n, 3) body's frame [m]


def read_strands(path: str, body: str) -> Strands:
    """Reads the strands of a file that end on a body.

    JSON: an object NAME: {"points": [["patella", [x, y, z]], [BODY, [x, y, z]]], "linear_stiffness_N_per_strain": k,
    "slack_length_m": L0}; strands of other bodies are ignored. CSV: columns name, stiffness_N_per_strain,
    slack_length_m, insertion_x_m, ..., origin_z_m. Raises InputError for no such file, not JSON or CSV, missing values,
    and two strands with the same name.
    """
    if path.lower().endswith(".json"):
        rows = _json_rows(path, body)
    elif path.lower().endswith(".csv"):
        rows = _csv_rows(path)
    else:
        raise InputError("unknown kind of file", where=path, expected=".json or .csv")
    refuse_repeated([name for name, _ in rows], "strands", where=path)
    table = np.array([values for _, values in rows], dtype=np.float64).reshape(len(rows), 8)
    for (name, _), values in zip(rows, table, strict=True):
        if not (np.isfinite(values).all() and values[0] > 0 and values[1] > 0):
            found = f"stiffness {values[0]:g} N per strain, slack length {values[1]:g} m"
            raise InputError(found, where=f"{path}, strand {name!r}", expected="positive, finite numbers")
    return Strands([name for name, _ in rows], table[:, 0], table[:, 1], table[:, 2:5], table[:, 5:])


def _json_rows(path: str, body: str) -> list[tuple[str, list[float]]]:
    data = read_json(path, expected='{"NAME": {"points": ...}, ...}')
    if not isinstance(data, dict):
        raise InputError("the file holds no object", where=path, expected='{"NAME": {"points": ...}, ...}')
    rows = []
    for name, strand in data.items():
        values = _json_strand(strand, body, f"{path}, strand {name!r}")
        if values is not None:
            rows.append((name, values))
    return rows


def _json_strand(strand: Any, body: str, where: str) -> list[float] | None:
    """Eight numbers of a strand; None if it does not connect the patella with this body."""
    try:
        ends = {str(segment): [float(v) for v in point] for segment, point in strand["points"]}
        if len(strand["points"]) != 2 or any(len(point) != 3 for point in ends.values()):
            raise ValueError("two points of three coordinates are needed")
        if set(ends) != {"patella", body}:
            return None
        size = [float(strand[key]) for key in ("linear_stiffness_N_per_strain", "slack_length_m")]
    except KeyError as error:
        raise InputError(f"{error.args[0]} is missing", where=where) from None
    except (TypeError, ValueError) as error:
        raise InputError(f"not a strand: {error}", where=where, expected="points, stiffness and slack length") from None
    return [*size, *ends["patella"], *ends[body]]


def _csv_rows(path: str) -> list[tuple[str, list[float]]]:
    lines, _ = read_lines(path)
    used = [(i, line) for i, line in enumerate(lines, start=1) if line.strip() and not line.startswith("#")]
    if not used:
        raise InputError("no header line", where=path, expected="a line of column names")
    table = [csv_cells(line, path=path, number=i) for i, line in used]
    header = [cell.strip() for cell in table[0]]
    refuse_repeated(header, "columns", where=path)
    for column in ("name", *_COLUMNS):
        if column not in header:
            raise unknown_name("column", column, header, where=path)
    rows = []
    for (line, _), cells in zip(used[1:], table[1:], strict=True):
        try:
            values = [number(cells[header.index(column)]) for column in _COLUMNS]
        except (ValueError, IndexError):
            raise InputError("a cell is missing or no number", where=f"{path}, line {line}") from None
        rows.append((cells[header.index("name")].strip(), values))
    return rows


def _selected(strands: Strands, patterns: list[str], body: str, path: str) -> Strands:
    keep = [i for i, name in enumerate(strands.names) if any(fnmatch.fnmatchcase(name, p) for p in patterns)]
    if not keep:
        raise InputError(
            f"no strand from the patella to the {body} is called {' or '.join(patterns)}",
            where=path,
            expected=", ".join(strands.names[:8]) or f"strands that end on the {body}",
        )
    return Strands([strands.names[i] for i in keep], *(values[keep] for values in strands[1:]))
