"""The summary: rows, columns and units, read by pyarrow, pandas and DuckDB."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from cheap_cohort import HEAD, CheapWork, cheap
from made_estimates import made_estimate

from fitting.cohort import run_cohort
from fitting.cohort.summary import _fitted, fit_dataset
from pftwin.base.errors import InputError, MissingExtraError

pandas = pytest.importorskip("pandas")
duckdb = pytest.importorskip("duckdb")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def summary(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("cohort")
    cohort = cheap(folder, 3)
    run_cohort(cohort, work=CheapWork(broken={("B", "fit"): InputError("no sense", where="B.trc")}))
    return cohort.output / "summary.parquet"


def test_a_row_for_each_patient_and_variant(summary):
    table = pandas.read_parquet(summary)
    assert table["patient"].tolist() == ["A", "A", "B", "C", "C"]
    assert table["status"].tolist() == ["done", "done", "failed", "done", "done"]
    assert table["variant"].dropna().tolist() == [0, 1, 0, 1]
    assert table.loc[2, ["failed_at", "reason"]].tolist() == ["fit", "B.trc: no sense"]
    np.testing.assert_array_equal(table["K1"], [65, 65, np.nan, 67, 67])
    np.testing.assert_allclose(table["K1_high"] - table["K1_low"], 2 * 1.959964 * table["K1_sd"], rtol=1e-6)
    np.testing.assert_array_equal(table["peak_contact_force"], [65, 75, np.nan, 67, 77])
    np.testing.assert_allclose(table["peak_contact_force_low"][0], 65 + 0.5 + 0.025 * 0.5)
    np.testing.assert_array_equal(table["medialisation"], [0, 0.01, np.nan, 0, 0.01])
    assert table["synthetic"].dropna().all()


def test_a_number_that_is_not_there_is_null(summary):
    table = parquet.read_table(summary)
    assert table["dislocation_time"].null_count == 5
    assert table["K1"].null_count == 1


def test_units_are_in_the_metadata(summary):
    schema = parquet.read_schema(summary)
    assert schema.field("K1_sd").metadata[b"units"] == b"N/m"
    assert schema.field("peak_contact_force_low").metadata[b"units"] == b"N"
    units = json.loads(schema.metadata[b"units"])
    assert units["medialisation"] == units["rmse_position"] == "m"
    assert schema.metadata[b"cohort"] == b"cheap"
    assert {n for n in schema.names if str(schema.field(n).type) == "double"} == set(units)


def test_duckdb_reads_it(summary):
    found = duckdb.sql(
        f"SELECT patient, max(peak_contact_force) FROM '{summary}' WHERE status = 'done' GROUP BY patient ORDER BY 1"
    ).fetchall()
    assert found == [("A", 75.0), ("C", 77.0)]


def test_who_is_pending_while_the_run_goes_on(tmp_path):
    cohort, statuses = cheap(tmp_path, 2), []

    def began(patient: str, kind: str) -> None:
        if (patient, kind) == ("B", "prediction"):
            statuses.extend(parquet.read_table(cohort.output / "summary.parquet")["status"].to_pylist())

    run_cohort(cohort, work=CheapWork(began=began))
    assert statuses == ["done", "done", "pending"]


def test_without_a_fit_or_treatments(tmp_path):
    only_fit = HEAD[: HEAD.index("[[treatment]]")]

    class NoTreatment(CheapWork):
        def predict(self, patient, estimate, tell):
            self._begins(patient, "prediction")

    cohort = cheap(tmp_path, 1, only_fit)
    run_cohort(cohort, work=NoTreatment())
    table = pandas.read_parquet(cohort.output / "summary.parquet")
    assert table["K1"].tolist() == [65.0]
    assert table["variant"].isna().all()


def test_without_pyarrow_it_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    work = CheapWork()
    with pytest.raises(MissingExtraError, match=r"the summary of a cohort needs the package 'pyarrow'; try: .*cohort"):
        run_cohort(cheap(tmp_path, 1), work=work)
    assert work.ran == []


@pytest.mark.parametrize("key", ["auxiliary", "besides"])  # the latter in stores that were written before
def test_nuisance_is_in_the_store_alone(key):
    found = made_estimate({"K1": (160.0, 2.0), "contact.friction.coefficient": (0.03, 0.01)})
    found.auxiliary = ("contact.friction.coefficient",)
    units: dict[str, str] = {}
    store = fit_dataset(found)
    store.attrs[key] = store.attrs.pop("auxiliary")
    row = _fitted(store, units)
    assert {"K1", "K1_sd", "K1_low", "K1_high"} <= row.keys()
    assert not any("friction" in column for column in (*row, *units))
