"""What all studies stand on: runs until an interrupt, differences of motions, tables that are read back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from small_scene import small_result

from pftwin.base.sheet import Column, Sheet, short_number, to_dataset
from pftwin.base.spatial import Quaternion
from pftwin.studies.runs import difference, rms, run_each


def stopping(at: int):
    def run(k: int) -> int:
        if k == at:
            raise KeyboardInterrupt
        return 10 * k

    return run


def test_an_interrupt_leaves_what_is_done():
    seen, kept = [], []
    answers = run_each(
        [0, 1, 2, 3], stopping(2), before=lambda k, v: seen.append((k, v)), after=lambda a: kept.append([*a])
    )
    assert answers == [0, 10]
    assert seen == [(0, 0), (1, 1), (2, 2)]
    assert kept == [[0], [0, 10]]


def test_an_interrupt_before_the_first_is_one():
    with pytest.raises(KeyboardInterrupt):
        run_each([0, 1], stopping(0))


def test_a_turned_patella_moves_its_points_by_the_chord():
    """About the lateral axis by 0.1 rad: a point 30 mm off the axis moves by 2 r sin(a / 2), one on it not at all."""
    own = small_result()
    turn = Quaternion(*np.array([np.cos(0.05), 0.0, np.sin(0.05), 0.0]))
    turned = replace(own, quaternion=np.asarray((Quaternion(*own.quaternion.T) * turn).array()))
    off = difference(turned, own, np.array([0.03, 0.2, 0.0]))
    np.testing.assert_allclose(off.center, 2 * 0.03 * np.sin(0.05), rtol=1e-9)
    np.testing.assert_allclose(difference(turned, own, np.array([0.0, 0.2, 0.0])).center, 0, atol=1e-12)
    assert off.contact is not None
    assert not off.contact.any()


def test_angles_are_compared_across_half_a_turn():
    own = small_result()
    there, back = (np.tile([np.cos(a / 2), np.sin(a / 2), 0.0, 0.0], (len(own.times), 1)) for a in (3.1, -3.1))
    a, b = replace(own, quaternion=there), replace(own, quaternion=back)
    apart = difference(a, b, np.zeros(3))
    angles = [np.asarray(x) for x in (apart.flexion, apart.rotation, apart.tilt)]
    assert max(np.abs(x).max() for x in angles) == pytest.approx(2 * np.pi - 6.2, rel=1e-6)


def test_rms_is_the_root_of_the_mean_square():
    assert rms(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


@dataclass(frozen=True)
class Line:
    """A row."""

    name: str
    steps: int
    error_mm: float


LINES = [Line('one, "two"', 3, 0.125), Line("none", 0, float("nan"))]


def columns(rows) -> list[Column]:
    kinds = {"name": (), "steps": ("1", "steps"), "error_mm": ("mm", "error")}
    return [Column(key, [getattr(r, key) for r in rows], *more) for key, more in kinds.items()]


def test_figures_of_a_dataset_have_units_and_words_have_none():
    data = to_dataset(columns(LINES), "line", {"scene": "a", "synthetic": True}, names="name")
    assert dict(data.sizes) == {"line": 2}
    assert data.error_mm.attrs == {"units": "mm", "long_name": "error"}
    assert list(data.line.values) == ['one, "two"', "none"]
    assert data.attrs == {"scene": "a", "synthetic": 1}


def test_a_sheet_escapes_what_would_break_it():
    sheet = Sheet("title", ("a", "b"), (("x|y", "[bold]"), ("1", "2")), ("p", "q"), words=(0,), notes=("note",))
    assert sheet.grid().splitlines() == ["| a | b |", "| --- | ---: |", "| x/y | [bold] |", "| 1 | 2 |"]
    assert sheet.markdown().endswith("| 1 | 2 |\n\n- note\n")
    assert sheet.tables(200)[0].row_count == 2
    assert sheet.tables(200)[0].rows[0].end_section


@pytest.mark.parametrize(("value", "said"), [(0.1234, "0.12"), (99.4, "99"), (1234.5, "1,234"), (np.nan, "-")])
def test_figures_in_two_digits(value, said):
    assert short_number(value) == said
