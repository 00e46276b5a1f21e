"""One simulation of a report, loaded from a file or taken from memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.dynamics.status import FLAGS
from pftwin.results.verdict import REMARKS, Verdict, verdict_of_file

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

_ANGLES = ("flexion", "rotation", "tilt")


@dataclass(frozen=True, eq=False)
class ReportedRun:
    """One simulation of a report."""

    name: str
    data: Dataset
    source: Path | Result  # what the viewer draws

    @classmethod
    def of_file(cls, path: Path, name: str | None = None) -> ReportedRun:
        """Loads a file that `Result.save` wrote; InputError for any other file."""
        from pftwin.files.result_files import load_dataset

        data = load_dataset(path)
        if "variant" in data.dims:
            found = "holds a prediction of treatments, not a simulation"
            remedy = f"pftwin report fit.json --treatment {path} -o report.html"
            expected = "fit.json, the demo's folder, or a result of `pftwin simulate`"
            raise InputError(found, where=path, expected=expected, remedy=remedy)
        absent = [n for n in ("patella_quaternion", "sphere_center", "status") if n not in data]
        if absent or data.sizes.get("time", 0) < 1:
            found = f"no simulation in it: it lacks {', '.join(absent) or 'frames'}"
            expected, remedy = "a result of `pftwin simulate`", "pftwin simulate --case 2 -o case2.nc"
            raise InputError(found, where=path, expected=expected, remedy=remedy)
        return cls(name or str(data.attrs.get("scene", path.stem)), data, path)

    @classmethod
    def of_result(cls, result: Result, name: str) -> ReportedRun:
        """Wraps a result in memory."""
        return cls(name, result.to_dataset(), result)

    @property
    def about(self) -> dict[str, Any]:
        """Attributes of the file."""
        return self.data.attrs

    @property
    def note(self) -> str:
        """Remark about the motion, for example that it is synthetic."""
        return str(self.about.get("note", ""))

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the motion is valid."""
        return verdict_of_file(self.data)

    @property
    def tracking(self) -> str:
        """Tracking of the patella in words; "INVALID" and the reasons if the motion is not valid."""
        if not self.verdict.valid:
            return self.verdict.describe()
        return str(self.about.get("tracking", "not in the file"))

    @property
    def contact(self) -> str | None:
        """Name of the effect that is the button's contact; None without one."""
        names = [str(n).removesuffix("_force_medial") for n in self.data.data_vars if str(n).endswith("_force_medial")]
        return next((n for n in names if f"{n}_force" in self.data), None)

    @property
    def marks(self) -> list[tuple[int, str]]:
        """Number of frames with each flag, and the flag in words; flags that do not affect the verdict come last."""
        return [mark for remark in (False, True) for mark in self._marks(remark=remark)]

    @property
    def remarks(self) -> list[str]:
        """What a summary of the result calls remarks: flags that do not affect the verdict, with their frames."""
        return [f"{count} of {self.data.sizes['time']} frames: {words}" for count, words in self._marks(remark=True)]

    @property
    def flagged(self) -> bool:
        """Whether any frame has a flag that is not a remark."""
        return bool(self._marks(remark=False))

    def _marks(self, *, remark: bool) -> list[tuple[int, str]]:
        status = self.data["status"].values
        counts = {f: int(np.count_nonzero(status & int(f))) for f in FLAGS if (f in REMARKS) == remark}
        return [(count, flag.describe()) for flag, count in counts.items() if count]

    @cached_property
    def result(self) -> Any:
        """The result; for a file, an object with the attributes of a result that the figures read."""
        if not isinstance(self.source, Path):
            return self.source
        data = self.data
        angles = {n: np.radians(data[f"patella_{n}"].values) for n in _ANGLES}
        contact = self.contact
        forces = {} if contact is None else {contact: {"force": data[f"{contact}_force"].values}}
        return SimpleNamespace(
            scene_name=self.name,
            times=data["time"].values,
            center=data["sphere_center"].values,
            angles=SimpleNamespace(**angles),
            knee=SimpleNamespace(flexion=np.radians(data["knee_flexion"].values)),
            contact=contact,
            effects=forces,
            scene=SimpleNamespace(synthetic="synthetic" in self.note),
            verdict=self.verdict,
            groove=(None, data["groove_offset"].values) if "groove_offset" in data else None,
        )
