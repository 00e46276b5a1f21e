"""The page of treatments has every treatment, outcome and index that the code has."""

from __future__ import annotations

from pathlib import Path

import pytest
import treatment_tables

from fitting.prediction.clinical_indices import ClinicalIndices
from fitting.prediction.outcomes import MEASURES
from fitting.treatments import KINDS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "treatments.md"


def test_everything_is_on_the_page() -> None:
    page = treatment_tables.filled(PAGE.read_text(encoding="utf-8"))
    assert "<!-- table" not in page
    for name, kind in KINDS.items():
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        assert all(f"`{amount}` [{way.unit}]" in row for amount, way in kind.amounts.items())
    for name, measure in MEASURES.items():
        assert f"| `{name}` | {measure.unit} | {measure.long_name} |" in page


def test_every_index_of_a_scene_has_a_row() -> None:
    assert set(treatment_tables._INDICES) == set(ClinicalIndices.__dataclass_fields__)


def test_a_page_without_a_place_for_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="no place for its table of treatments"):
        treatment_tables.filled("# Treatments")
