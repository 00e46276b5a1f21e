"""A patient's store: one NetCDF file with the groups `fit` and `prediction`.

NetCDF and not Zarr: everything else that pftwin writes is NetCDF, and one file is replaced in one step, while a Zarr
store is a folder of files that a kill can leave half old and half new.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cohort.units import Unit, versions

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate

_TEXTS = ("method", "objective", "objective_unit", "reason", "source", "scene_name")
_NUMBERS = ("objective_value", "serial_correlation", "condition", "seed", "evaluations", "iterations", "starts")


def write_store(
    path: Path, unit: Unit, scene: dict[str, Any], estimate: Estimate | None, prediction: Dataset | None
) -> None:
    """Writes the file, whole or not at all.

    Args:
        path: of the file.
        unit: whose file it is.
        scene: attributes that say where the numbers come from.
        estimate: the fit, where there is one.
        prediction: of `fitting.predict`, where there is one.

    Raises:
        OutputError: it cannot be written.
    """
    from xarray import Dataset

    from pftwin.files.result_files import save_dataset

    about = {"title": f"patient {unit.patient}", "patient": unit.patient, "key": unit.key, **versions(), **scene}
    groups = {} if estimate is None else {"fit": fit_dataset(estimate)}
    groups |= {} if prediction is None else {"prediction": prediction}
    about["groups"] = " ".join(groups)
    save_dataset(Dataset(attrs=about), path, groups=groups)


def fit_dataset(estimate: Estimate) -> Dataset:
    """An estimate over its parameters, in SI units."""
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
    for name in ("rmse", "noise"):
        attributes[name] = json.dumps(getattr(estimate, name))  # m, rad and N, by channel
    attributes |= {
        "synthetic": int(estimate.synthetic),
        "at_bounds": " ".join(estimate.at_bounds),
        "sentence": estimate.sentence(),
        "remarks": "; ".join(estimate.remarks()),
    }
    plain = {k: float(v) if isinstance(v, np.floating) else v for k, v in attributes.items()}
    return Dataset(data, coordinates, plain)


def read_store(path: Path) -> tuple[dict[str, Any], Dataset | None, Dataset | None]:
    """Attributes of a store, its fit, and its prediction.

    Raises:
        InputError: no store.
    """
    from pftwin.files.result_files import load_dataset

    about = dict(load_dataset(path).attrs)
    groups = str(about.get("groups", "")).split()
    fit, prediction = (load_dataset(path, group=g) if g in groups else None for g in ("fit", "prediction"))
    return about, fit, prediction
