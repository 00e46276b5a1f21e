"""A patient's store, and summary.parquet: one table of a whole cohort, for pandas, R and DuckDB.

A store is one NetCDF file with the groups `fit` and `prediction`, not Zarr: everything else that pftwin writes is
NetCDF, and one file is replaced in one step, while a kill can leave the files of a Zarr folder half old and half new.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cohort.description import Cohort
from fitting.cohort.manifest import SUMMARY, Failure, Manifest, SummaryChecksums, Unit, file_digest, versions
from fitting.programs import unit_of
from pftwin.base.errors import MissingExtraError
from pftwin.base.output import written_whole

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate

_TEXTS = ("method", "objective", "objective_unit", "reason", "source", "scene_name")
_NUMBERS = ("objective_value", "serial_correlation", "condition", "seed", "evaluations", "iterations", "starts")


def write_store(
    path: Path, unit: Unit, scene: dict[str, Any], estimate: Estimate | None, prediction: Dataset | None
) -> None:
    """Writes a store, complete or not at all; `scene` states the scene and whether it is synthetic. Raises OutputError
    if it cannot be written."""
    from xarray import Dataset

    from pftwin.files.result_files import save_dataset

    about = {"title": f"patient {unit.patient}", "patient": unit.patient, "key": unit.key, **versions(), **scene}
    groups = {} if estimate is None else {"fit": fit_dataset(estimate)}
    groups |= {} if prediction is None else {"prediction": prediction}
    about["groups"] = " ".join(groups)
    save_dataset(Dataset(attrs=about), path, groups=groups)


def fit_dataset(estimate: Estimate) -> Dataset:
    """An estimate as a dataset over its parameters, in SI units."""
    from xarray import Dataset

    low, high = estimate.intervals.T
    columns = {
        "value": (estimate.values, "best value"),
        "standard_deviation": (estimate.standard_deviations, "standard deviation"),
        "low": (low, "95 % interval, lower end"),
        "high": (high, "95 % interval, upper end"),
        "nominal": (estimate.nominal, "where the search began"),
        "lower_bound": (estimate.lower, "lower bound of the search"),
        "upper_bound": (estimate.upper, "upper bound of the search"),
    }
    over = {"units": "as parameter_unit"}
    data: dict[str, Any] = {n: (("parameter",), v, {**over, "long_name": words}) for n, (v, words) in columns.items()}
    both = ("parameter", "other_parameter")
    data["covariance"] = (both, estimate.covariance, {"units": "product of both", "long_name": "covariance"})
    coordinates = {
        "parameter": list(estimate.names),
        "other_parameter": list(estimate.names),
        "parameter_unit": (("parameter",), list(estimate.units)),
    }
    attributes: dict[str, Any] = {n: getattr(estimate, n) for n in (*_TEXTS, *_NUMBERS)}
    for name in ("rmse", "noise", "readings"):
        attributes[name] = json.dumps(getattr(estimate, name))  # by channel
    attributes |= {
        "synthetic": int(estimate.synthetic),
        "at_bounds": " ".join(estimate.at_bounds),
        "auxiliary": " ".join(estimate.auxiliary),
        "sentence": estimate.sentence(),
        "remarks": "; ".join(estimate.remarks()),
    }
    values = {k: float(v) if isinstance(v, np.floating) else v for k, v in attributes.items()}
    return Dataset(data, coordinates, values)


def read_store(path: Path) -> tuple[dict[str, Any], Dataset | None, Dataset | None]:
    """Attributes of a store, its fit, and its prediction. Raises InputError if the file is not a store."""
    from pftwin.files.result_files import load_dataset

    about = dict(load_dataset(path).attrs)
    groups = str(about.get("groups", "")).split()
    fit, prediction = (load_dataset(path, group=g) if g in groups else None for g in ("fit", "prediction"))
    return about, fit, prediction


# Columns of every summary; those of parameters, amounts and outcomes follow, all float64.
_TYPES = {"synthetic": "bool", "variant": "int64", "variant_failed": "bool"}  # of columns that are not strings
_NAMES = (
    *("patient", "status", "failed_at", "reason", "scene", "synthetic"),  # status: done, failed, pending
    *("fit_method", "fit_stopped", "at_bounds", "variant", "treatment", "verdict", "variant_failed"),
)
FIXED = {name: _TYPES.get(name, "string") for name in _NAMES}
_STORE_ONLY = ("status", "status_frames")  # `verdict` summarises them; `status` here is the patient's
Row = dict[str, Any]
Units = dict[str, str]


def require_pyarrow() -> None:
    """Checks early for pyarrow, which is needed only at the end of a long run. Raises MissingExtraError if it is not
    installed."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise MissingExtraError("pyarrow", extra="cohort", feature="the summary of a cohort") from None


def rows_of(path: Path) -> tuple[list[Row], Units]:
    """A patient's rows from the store, one per variant, and the columns' units. Raises InputError for no store."""
    about, fit, prediction = read_store(path)
    units: Units = {}
    row: Row = {"patient": str(about["patient"]), "status": "done", "scene": str(about["scene"])}
    row["synthetic"] = bool(about["synthetic"])
    if fit is not None:
        row |= _fitted(fit, units)
    if prediction is None:
        return [row], units
    return [{**row, **more} for more in _predicted(prediction, units)], units


def table(rows: Iterable[Row], units: Mapping[str, str], about: Mapping[str, Any]) -> bytes:
    """The Parquet table, with null for missing values; its metadata hold the columns' units and `about`."""
    import pyarrow as pa
    from pyarrow import parquet

    # Null instead of NaN, which would spoil means in SQL.
    listed = [{name: None if value != value else value for name, value in row.items()} for row in rows]
    fields = []
    for name in dict.fromkeys([*FIXED, *(n for row in listed for n in row)]):
        kind = pa.type_for_alias(FIXED.get(name, "float64"))
        fields.append(pa.field(name, kind, metadata={"units": units[name]} if name in units else None))
    metadata = {"units": json.dumps(dict(units)), **{k: str(v) for k, v in about.items()}}
    out = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(listed, pa.schema(fields, metadata)), out, compression="zstd")
    return out.getvalue()


def _fitted(fit: Dataset, units: Units) -> Row:
    about = fit.attrs
    row: Row = {"fit_method": about["method"], "fit_stopped": about["reason"], "at_bounds": about["at_bounds"]}
    auxiliary = str(about.get("auxiliary", about.get("besides", ""))).split()  # key in older stores: besides
    for name, unit in zip(fit["parameter"].values, fit["parameter_unit"].values, strict=True):
        if name in auxiliary:
            continue
        at, column = fit.sel(parameter=name), str(name).replace(".", "_")
        for ending, variable in (("", "value"), ("_sd", "standard_deviation"), ("_low", "low"), ("_high", "high")):
            row[column + ending] = float(at[variable])
            units[column + ending] = str(unit)
    for channel, value in json.loads(about["rmse"]).items():
        column = f"rmse_{channel}".replace(".", "_")
        row[column] = float(value)
        units[column] = "m" if channel in ("X", "Y", "Z") else unit_of(channel, json.loads(about["readings"]))
    return row


def _predicted(data: Dataset, units: Units) -> Iterable[Row]:
    """Outcomes for the estimate and, with samples, the 95 % band of the draws."""
    from fitting.prediction.plots import facts

    found = facts(data)
    for name, unit in found["units"].items():
        if name != "failed":
            units[name] = unit
            if name in found["bands_95"]:
                units[f"{name}_low"] = units[f"{name}_high"] = unit
    for i, variant in enumerate(found["variants"]):
        row: Row = {"variant": i}
        for name, value in variant.items():
            if name in _STORE_ONLY:
                continue
            row["variant_failed" if name == "failed" else name] = value
            if name in found["bands_95"]:
                low, high = (band[i] for band in found["bands_95"][name])
                row |= {f"{name}_low": float(low), f"{name}_high": float(high)}
        yield row


class SummaryFile:
    """The cohort's summary, from the stores of the completed patients."""

    def __init__(self, cohort: Cohort, folder: Path, manifest: Manifest) -> None:
        self.cohort, self.folder, self.manifest = cohort, folder, manifest
        self.rows: dict[str, list[Row]] = {}
        self.units: Units = {}

    def read(self, patient: str, unit: Unit) -> None:
        """Reads a patient's store. Raises InputError if it is not one."""
        self.rows[patient], units = rows_of(self.folder / unit.file)
        self.units |= units

    def write(self, failures: dict[str, Failure]) -> None:
        """Announces the summary in the manifest, then writes it unless it is unchanged. Raises OutputError if the
        manifest or the summary cannot be written."""
        rows: list[Row] = []
        for patient in self.cohort.patients:
            if (failure := failures.get(patient.name)) is not None:
                why = {"failed_at": failure.stage, "reason": failure.message}
                rows.append({"patient": patient.name, "status": "failed", **why})
            else:
                rows += self.rows.get(patient.name) or [{"patient": patient.name, "status": "pending"}]
        content = table(rows, self.units, {"cohort": self.cohort.name, **versions()})
        path, digest = self.folder / SUMMARY, hashlib.sha256(content).hexdigest()
        there = file_digest(path) if path.is_file() else None
        self.manifest.summary = SummaryChecksums(digest, there)
        self.manifest.save(self.folder)
        if there == digest:
            return
        with written_whole(path) as temporary:
            temporary.write_bytes(content)
