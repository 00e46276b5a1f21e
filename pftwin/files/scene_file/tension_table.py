"""[[prescribed_tension]]: muscles with a given tension, constant, over time or by the knee's flexion."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.files.mocap import Table, read_readings
from pftwin.files.mocap.tables import uniform_times
from pftwin.files.scene_file.effect_tables import Body, EffectSection, Setting
from pftwin.files.scene_file.section import FileName, NotNegative, Points, problem
from pftwin.files.scene_file.wrap_table import WRAP, Wrap, obstacle
from pftwin.model.effects.tension import PrescribedTension


class PrescribedTensionSection(EffectSection):
    """Lines of given tension.

    A file has the columns time_s and, for every line, LINE_tension_N (or LINE_N for lines named in `lines`) and, unless
    the table gives them, LINE_origin_x_m, _y_m, _z_m (or LINE_via_BODY_x_m ...; may move) and LINE_insertion_x_m ...
    (or LINE_insertion_patella_x_m ...; must be constant). Without a file, `tension_N` are constant
    tensions; or, with `at_flexion_deg`, tensions of all lines together at these flexions of the knee.
    """

    kind: ClassVar[str] = "prescribed_tension"
    body: Body = Field(description="body at the other end")
    file: FileName | None = Field(
        default=None, description="CSV file with time_s and LINE_tension_N, or C3D with analog channels LINE_tension"
    )
    tension_N: list[NotNegative] | None = Field(  # noqa: N815
        default=None,
        description="instead of a file: constant tension of each line; with at_flexion_deg, that of all together [N]",
    )
    at_flexion_deg: list[float] | None = Field(
        default=None,
        description="flexions of the knee, rising, one for each of tension_N: linear between, constant beyond [deg]",
    )
    shares: list[NotNegative] | None = Field(
        default=None, description="with at_flexion_deg: proportions in which the lines share the tension [-]; equal"
    )
    lines: list[str] | None = Field(default=None, description="names of the lines; by default all of the file's")
    insertion_m: Points | None = Field(default=None, description="insertion of each line, patella frame [m]")
    origin_m: Points | None = Field(default=None, description="origin of each line, the body's frame [m]")
    wrap: Wrap = WRAP

    def _check(self) -> None:
        if (self.file is None) == (self.tension_N is None):
            raise problem("neither file nor tension_N" if self.file is None else "both", expected="file or tension_N")
        if self.at_flexion_deg is None and self.shares is not None:
            raise problem("shares without at_flexion_deg", expected="both or neither")
        if self.tension_N is None:
            if self.at_flexion_deg is not None:
                raise problem("at_flexion_deg with a file", expected="tension_N at these flexions, or the file")
            return
        if self.insertion_m is None or self.origin_m is None:
            raise problem("tensions without ends", expected="insertion_m and origin_m")
        n, what = len(self.tension_N), "tensions"
        if self.at_flexion_deg is not None:
            n, what = len(self.insertion_m), "insertions"
        named = {"insertion_m": self.insertion_m, "origin_m": self.origin_m, "lines": self.lines, "shares": self.shares}
        for name, given in named.items():
            if given is not None and len(given) != n:
                raise problem(f"{name} has {len(given)} for {n} {what}", expected="one each")
        if self.shares is not None and sum(self.shares) == 0:
            raise problem("all shares are 0", expected="at least one above 0")

    def build(self, setting: Setting) -> PrescribedTension:
        """The effect."""
        knots = share = None
        if self.tension_N is None:
            with setting.naming("file"):
                start, interval, tension, origin, insertion = self._recorded(setting)
        else:
            start, interval, tension = 0.0, 1.0, np.asarray([self.tension_N])
            origin, insertion = np.asarray([self.origin_m]), np.asarray(self.insertion_m)
        if self.at_flexion_deg is not None:
            knots, tension = tuple(math.radians(angle) for angle in self.at_flexion_deg), tension[0]
            shares = np.ones(len(insertion)) if self.shares is None else np.asarray(self.shares)
            share = number(shares / shares.sum())
        with setting.naming():
            return PrescribedTension(
                number(tension),
                vector(setting.points(self.body, origin)),
                vector(setting.points("patella", insertion)),
                start_time=start,
                interval=interval,
                body=self.body,
                wrap=obstacle(self.wrap, len(insertion), setting),
                knots=knots,
                share=share,
                name=self.label,
            )

    def _recorded(self, setting: Setting) -> tuple[float, float, Floats, Floats, Floats]:
        """Reads first time and interval [s], tensions (n, m) [N], origins (n, m, 3) and insertions (m, 3) [m]."""
        if setting.document.given is not None:
            raise InputError(
                "tensions over time of the scene's own recording",
                where=setting.where("file"),
                expected="none beside another recording",
                remedy="tension_N, with at_flexion_deg for one that changes, or a scene file of that recording",
            )
        table = read_readings(setting.path(str(self.file)))
        times, motion = uniform_times(table.times, where=table.source), setting.bones.motion
        slack = 0.5 * motion.frame_interval
        if times.size < 2 or times[0] > motion.start_time + slack or times[-1] < motion.end_time - slack:
            raise InputError(
                f"{times.size} tensions from {times[0]:g} s to {times[-1]:g} s",
                where=table.source,
                expected=f"tensions for the whole motion, {motion.start_time:g} s to {motion.end_time:g} s",
            )
        lines = self.lines or [name.removesuffix("_tension") for name in table.names if name.endswith("_tension")]
        if not lines:
            raise InputError("no tensions", where=table.source, expected="columns LINE_tension_N")
        tension = self._tensions(table, lines)
        origin = self._ends(table, lines, self.origin_m, ("origin", f"via_{self.body}"), "origin_m")
        insertion = self._ends(table, lines, self.insertion_m, ("insertion", "insertion_patella"), "insertion_m")
        if (moved := np.ptp(insertion, axis=0).max(axis=-1) > 1e-6).any():
            found = f"the insertion of {lines[int(np.argmax(moved))]!r} moves on the patella"
            raise InputError(found, where=table.source, expected="a fixed insertion")
        interval = float(f"{(times[-1] - times[0]) / max(times.size - 1, 1):.12g}") or 1.0
        return float(times[0]), interval, tension, np.broadcast_to(origin, (*tension.shape, 3)), insertion[0]

    def _tensions(self, table: Table, lines: list[str]) -> Floats:
        known = set(table.names)
        names = [line if line in known and f"{line}_tension" not in known else f"{line}_tension" for line in lines]
        values = table.select(names).values
        for k, name in enumerate(names):
            if table.units[name] != "N":
                found = "no unit of force" if table.units[name] == "1" else f"its unit is {table.units[name]}"
                raise InputError(found, where=f"{table.source}, column {name!r}", expected=f"{name}_N, a unit of force")
            bad = np.flatnonzero(~(values[:, k] >= 0))
            if bad.size:
                raise InputError(
                    f"row {bad[0] + 1} holds {values[bad[0], k]:g}",
                    where=f"{table.source}, column {name!r}",
                    expected="a tension of zero or more in every row",
                )
        return values

    def _ends(
        self, table: Table, lines: list[str], given: list[list[float]] | None, labels: tuple[str, str], field: str
    ) -> Floats:
        """End points of the lines, (1 or n, n_lines, 3) [m]."""
        if given is not None:
            if len(given) not in (1, len(lines)):
                raise InputError(f"{field} has {len(given)} points for {len(lines)} lines: {', '.join(lines)}")
            return np.broadcast_to(np.asarray(given), (1, len(lines), 3))
        ends = []
        for line in lines:
            label = next((x for x in labels if f"{line}_{x}_x" in table.names), labels[0])
            columns = [f"{line}_{label}_{axis}" for axis in "xyz"]
            if columns[0] not in table.names:
                raise InputError(
                    f"no column {columns[0]}_m, and no {field} in the scene file",
                    where=table.source,
                    expected="either",
                )
            values = table.select(columns).values
            if any(table.units[c] != "m" for c in columns) or not np.isfinite(values).all():
                raise InputError("values without unit, or missing", where=f"{table.source}, columns {columns[0]} ...")
            ends.append(values)
        return np.stack(ends, axis=1)
