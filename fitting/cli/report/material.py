"""Data of a report, read from a fit, a result's file or the demo's folder."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fitting.cli.report.run import ReportedRun
from pftwin.base.errors import InputError
from pftwin.cli.scenes import chosen_scene
from pftwin.cli.terminal import spinner

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate
    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene

_RIG = re.compile(r"rig case ([1-4]), (\w+)")
_WHICH = "fit.json of `pftwin fit`, the folder of `pftwin demo`, or the NetCDF file of `pftwin simulate`"
_NAME_IT = "--scene knee/scene.toml or --case N"
DEMO_FIT = "fit.json"
NOMINAL = "nominal"  # name of the run with the parameters from before the fit


@dataclass(eq=False)
class Material:
    """All data of a report."""

    source: Path
    title: str
    estimates: dict[str, Estimate] = field(default_factory=dict)  # by name
    scene: Scene | None = None  # None if not known
    runs: list[ReportedRun] = field(default_factory=list)
    treatment: Dataset | None = None  # prediction of `pftwin treat`
    demo: Path | None = None  # the demo's folder, if `source` is one
    files: list[Path] = field(default_factory=list)  # all files that were read

    @property
    def estimate(self) -> Estimate | None:
        """The first estimate; None without any."""
        return next(iter(self.estimates.values()), None)

    @property
    def measured(self) -> Measured | None:
        """The scene's measurements, if there are any."""
        return None if self.scene is None else self.scene.measured

    @property
    def names(self) -> str:
        """Names of the runs, joined by "and"."""
        return " and ".join(r.name for r in self.runs)

    @property
    def has_nominal(self) -> bool:
        """Whether the runs are the nominal and the fitted motion."""
        return any(run.name == NOMINAL for run in self.runs)

    def changed_since(self, e: Estimate) -> list[str]:
        """Parameters whose values in the scene differ from the fit's nominal ones, a sign of a different scene."""
        if e.nominal_scene is None:
            return []
        here = [(n, e.nominal_scene.get(n), began) for n, began in zip(e.names[: e.shared], e.nominal, strict=False)]
        return [name for name, value, began in here if abs(value - began) > 1e-6 * abs(began)]

    def invalid(self) -> list[str]:
        """Descriptions of all INVALID motions, fits and variants of the prediction, with reasons."""
        from fitting.prediction.plots import invalid_variants, narrow_bands

        found = [f"{run.verdict.describe()} ({run.name})" for run in self.runs if not run.verdict.valid]
        found += [f"{e.sentence()} ({name})" for name, e in self.estimates.items() if e.invalid]
        if self.objection and not self.invalid_estimates:
            found.append(f"{self.objection} (the treatment's estimate)")
        variants = "" if self.treatment is None else invalid_variants(self.treatment) or narrow_bands(self.treatment)
        return [*found, *([f"{variants} (treatment)"] if variants else [])]

    def without_basis(self) -> str:
        """Names of the INVALID motions and fits that invalidate the prediction; empty if there are none."""
        unsound = [r.name for r in self.runs if r.name != NOMINAL and not r.verdict.valid]
        estimates = self.invalid_estimates or (["the treatment's estimate"] if self.objection else [])
        return " and ".join([*unsound, *estimates])

    @property
    def invalid_estimates(self) -> list[str]:
        """Names of the INVALID estimates."""
        return [name for name, e in self.estimates.items() if e.invalid]

    @property
    def objection(self) -> str:
        """Why nothing may be concluded from the prediction's own estimate; empty if it is valid."""
        return "" if self.treatment is None else str(self.treatment.attrs.get("objection", ""))

    def doubts(self) -> list[str]:
        """Signs that the prediction and the rest of the report are about different knees."""
        data, estimate, out = self.treatment, self.estimate, []
        if data is None:
            return out
        own = {str(run.about.get("scene", run.name)) for run in self.runs}
        if others := sorted(set(map(str, data["scene"].values)) - own):
            out.append(f"The prediction is of {', '.join(others)}; this report is of {', '.join(sorted(own))}.")
        if estimate is None:
            return out
        if "parameters" not in data:
            return [*out, "The prediction was made with the scene's own parameters, not with the fitted ones."]
        used = data["parameters"].values.reshape(-1, data.sizes["parameter"])[0]
        names = tuple(map(str, data["parameter"].values))
        if names != estimate.names or not np.allclose(used, estimate.values, rtol=1e-9, atol=0):
            out.append("The prediction was made with other parameters than those of the fit.")
        return out

    def synthetic(self) -> list[str]:
        """All remarks about synthetic data, without repetitions."""
        from pftwin.model.measured import SYNTHETIC

        remarks = [r.note for r in self.runs if "synthetic" in r.note]
        if self.scene is not None and self.scene.synthetic:
            remarks.append(SYNTHETIC)
        if any(e.synthetic for e in self.estimates.values()):
            remarks.append("the measurements are synthetic")
        if self.treatment is not None:
            note = str(self.treatment.attrs.get("note", ""))
            remarks += [part for part in note.split("; ") if "synthetic" in part]
            if int(self.treatment.attrs.get("synthetic", 0)) and not note:  # of an older file
                remarks.append("the parameters of the prediction were estimated from synthetic measurements")
        return list(dict.fromkeys(remarks))


def gather_material(
    source: Path, *, treatment: Path | None, scene: Path | None, case: int | None, contact: str | None
) -> Material:
    """Reads the report's data; for an estimate, simulates the nominal and the fitted motion.

    Without a scene or a case, the scene is the rig's case that the estimate was fitted to. Raises InputError for a
    source that is neither an estimate, a demo's folder nor a result, and for a scene that is missing or does not match.
    """
    if scene is None and case is None and contact is not None:
        raise InputError("--contact without a scene", expected=_NAME_IT)
    given = None if scene is None and case is None else chosen_scene(scene, case, contact).scene
    predicted = None if treatment is None else _prediction(treatment)
    if source.is_dir():
        found = _of_demo(source, given)
    elif not source.exists():
        raise InputError("there is no such file", where=source, expected=_WHICH)
    elif source.suffix.lower() == ".json":
        found = _of_estimate(source, given)
    elif source.suffix.lower() == ".nc":
        run = ReportedRun.of_file(source)
        _check_same(str(run.about.get("scene", "")), given, source)
        found = Material(source, f"Simulated knee: {run.name}", scene=given, runs=[run], files=[source])
    else:
        raise InputError("not a file that a report can be made from", where=source, expected=_WHICH)
    found.treatment = predicted
    if treatment is not None:
        found.files.append(treatment)
    return found


def _of_estimate(path: Path, given: Scene | None) -> Material:
    """Reads an estimate and its scene, and simulates the nominal and the fitted motion."""
    from fitting.estimate import Estimate
    from pftwin.dynamics.simulate import simulate

    loaded = Estimate.load(path)
    scene = _scene_of(loaded, given, path)
    estimate = loaded.about(scene)
    scenes = {NOMINAL: scene, "fitted": estimate.scene}
    with spinner("compiling and simulating"):
        runs = [ReportedRun.of_result(simulate(one), name) for name, one in scenes.items()]
    title = f"Fitted knee: {estimate.scene_name}"
    return Material(path, title, {"the fit": estimate}, scene, runs, files=[path])


def _of_demo(folder: Path, given: Scene | None) -> Material:
    """Reads the demo's fits, and its results before and after the treatment."""
    from fitting.demo.paper_study import PATHOLOGY, TREATMENT
    from fitting.estimate import Estimate

    if not (folder / DEMO_FIT).is_file():
        expected = "the folder of `pftwin demo`, or a file"
        found = f"there is no {DEMO_FIT} in this folder"
        raise InputError(found, where=folder, expected=expected, remedy="pftwin demo --out demo")
    fits = {
        "the paper's objective": folder / DEMO_FIT,
        "simulations, from positions": folder / "fit_positions.json",
        "simulations, and one force": folder / "fit_force.json",
    }
    present = {name: path for name, path in fits.items() if path.is_file()}
    loaded = {name: Estimate.load(path) for name, path in present.items()}
    first = next(iter(loaded.values()))
    scene = _scene_of(first, given, folder / DEMO_FIT)
    estimates = {name: estimate.about(scene) for name, estimate in loaded.items()}
    named = _case_of(first)
    contact = named[1] if named else "P5"
    words = {PATHOLOGY: "pathology", TREATMENT: "treatment"}
    results = {folder / f"case{n}_{contact}.nc": f"case {n}, {what}" for n, what in words.items()}
    runs = [ReportedRun.of_file(path, name) for path, name in results.items() if path.is_file()]
    files = [*present.values(), *(p for p in results if p.is_file())]
    return Material(folder, "The demo on the virtual rig", estimates, scene, runs, demo=folder, files=files)


def _scene_of(estimate: Estimate, given: Scene | None, path: Path) -> Scene:
    """The given scene, or by default the rig's case that was fitted."""
    if given is None:
        named = _case_of(estimate)
        if named is None:
            found = f"the estimate is of the scene {estimate.scene_name!r}, which is not in its file"
            raise InputError(found, where=path, expected="the scene beside it", remedy=_NAME_IT)
        return chosen_scene(None, *named).scene
    _check_same(next(iter(estimate.trial_rmse), estimate.scene_name), given, path)  # first of several trials
    return given


def _case_of(estimate: Estimate) -> tuple[int, str] | None:
    """Number and contact of the rig's case that was fitted to its own measurements; None for any other estimate.

    The scene's name alone does not suffice: a user's scene may have the same name.
    """
    from pftwin.rig.recording import source_of

    named = _RIG.fullmatch(estimate.scene_name)
    if named is None or estimate.source != source_of(int(named.group(1))):
        return None
    return int(named.group(1)), named.group(2)


def _check_same(name: str, given: Scene | None, path: Path) -> None:
    """Raises InputError if a scene's name is not the file's: the report would mix two knees."""
    if given is not None and given.name != name:
        raise InputError(
            f"belongs to the scene {name!r}, but the given scene is {given.name!r}",
            where=path,
            expected="the scene that was simulated or fitted",
            remedy=f"{_NAME_IT}, with --contact where the scene's own was replaced",
        )


def _prediction(path: Path) -> Dataset:
    """Loads a prediction of `pftwin treat`; InputError for any other file."""
    from pftwin import __version__
    from pftwin.files.result_files import load_dataset

    data = load_dataset(path)
    needed = (
        "dislocations",
        "largest_offset",
        "largest_lateral_offset",
        "peak_contact_force",
        "mean_tilt",
        "medial_share",
        "failed",
    )
    if "variant" not in data.dims or any(n not in data for n in needed):
        raise InputError(
            "no prediction of treatments in it",
            where=path,
            expected=f"what `pftwin treat` of pftwin {__version__} wrote",
            remedy="pftwin treat --case 2 --estimate fit.json --tto-medial 0:20:4 -o variants.nc",
        )
    return data
