"""summary.parquet: one table of a whole cohort, a row for each patient and variant, for pandas, R and DuckDB."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.cohort.manifest import Failure
from fitting.cohort.store import read_store
from pftwin.base.errors import MissingExtraError

if TYPE_CHECKING:
    from xarray import Dataset

# Columns that every summary has; those of parameters, amounts and outcomes follow as they come, all float64.
FIXED = {
    "patient": "string",
    "status": "string",  # done, failed, pending
    "failed_at": "string",
    "reason": "string",
    "scene": "string",
    "synthetic": "bool",
    "fit_method": "string",
    "fit_stopped": "string",
    "at_bounds": "string",
    "variant": "int64",
    "treatment": "string",
    "variant_failed": "bool",
}
Row = dict[str, Any]
Units = dict[str, str]


def require_pyarrow() -> None:
    """Refuses early: a summary is wanted at the end of a long run.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise MissingExtraError("pyarrow", extra="cohort", feature="the summary of a cohort") from None


def rows_of(path: Path) -> tuple[list[Row], Units]:
    """A patient's rows from the store, one for each variant, and the columns' units.

    Raises:
        InputError: no store.
    """
    about, fit, prediction = read_store(path)
    units: Units = {}
    row: Row = {"patient": str(about["patient"]), "status": "done", "scene": str(about["scene"])}
    row["synthetic"] = bool(about["synthetic"])
    if fit is not None:
        row |= _fitted(fit, units)
    if prediction is None:
        return [row], units
    return [{**row, **more} for more in _predicted(prediction, units)], units


def row_without(patient: str, failure: Failure | None) -> Row:
    """Of a patient without results: failed, or pending."""
    if failure is None:
        return {"patient": patient, "status": "pending"}
    return {"patient": patient, "status": "failed", "failed_at": failure.stage, "reason": failure.message}


def table(rows: Iterable[Row], units: Mapping[str, str], about: Mapping[str, Any]) -> bytes:
    """The Parquet file.

    Args:
        rows: in the order of the file; what a row lacks is null there.
        units: by column: SI units and degrees.
        about: what else the file's metadata say, for every reader.
    """
    import pyarrow as pa
    from pyarrow import parquet

    listed = list(rows)
    names = list(dict.fromkeys([*FIXED, *(n for row in listed for n in row)]))
    fields, columns = [], []
    for name in names:
        kind = pa.type_for_alias(FIXED.get(name, "float64"))
        metadata = {"units": units[name]} if name in units else None
        fields.append(pa.field(name, kind, metadata=metadata))
        columns.append(pa.array([_there(row.get(name)) for row in listed], kind))
    metadata = {"units": json.dumps(dict(units)), **{k: str(v) for k, v in about.items()}}
    whole = pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata))
    out = io.BytesIO()
    parquet.write_table(whole, out, compression="zstd")
    return out.getvalue()


def _fitted(fit: Dataset, units: Units) -> Row:
    row: Row = {"fit_method": fit.attrs["method"], "fit_stopped": fit.attrs["reason"]}
    row["at_bounds"] = fit.attrs["at_bounds"]
    for name, unit in zip(fit["parameter"].values, fit["parameter_unit"].values, strict=True):
        at, column = fit.sel(parameter=name), str(name).replace(".", "_")
        for ending, variable in (("", "value"), ("_sd", "standard_deviation"), ("_low", "low"), ("_high", "high")):
            row[column + ending] = float(at[variable])
            units[column + ending] = str(unit)
    for channel, value in json.loads(fit.attrs["rmse"]).items():
        column = f"rmse_{channel}".replace(".", "_")
        row[column] = float(value)
        units[column] = {"position": "m", "X": "m", "Y": "m", "Z": "m", "orientation": "rad"}.get(channel, "N")
    return row


def _predicted(data: Dataset, units: Units) -> Iterable[Row]:
    """Of the estimate itself, and with samples the 95 % band of the draws."""
    from fitting.prediction.table import facts

    found = facts(data)
    for name, unit in found["units"].items():
        if name != "failed":
            units[name] = unit
            if name in found["bands_95"]:
                units[f"{name}_low"] = units[f"{name}_high"] = unit
    for i, variant in enumerate(found["variants"]):
        row: Row = {"variant": i}
        for name, value in variant.items():
            row["variant_failed" if name == "failed" else name] = value
            if name in found["bands_95"]:
                low, high = (band[i] for band in found["bands_95"][name])
                row |= {f"{name}_low": float(low), f"{name}_high": float(high)}
        yield row


def _there(value: Any) -> Any:
    """Null where there is no number: NaN would spoil means in SQL."""
    return None if isinstance(value, float) and math.isnan(value) else value
