"""Amounts as people write them."""

from __future__ import annotations

import math

import pytest

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import amount, amounts_in, listed, number_and_unit, numbers_by_name, units_beside


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("16 mm", "mm", 16.0),
        ("1.6 cm", "mm", 16.0),
        ("0.016 m", "mm", 16.0),
        ("16000um", "mm", 16.0),
        ("16000 µm", "mm", 16.0),
        ("16", "mm", 16.0),
        (" -1.5e1 ", "mm", -15.0),
        ("0.2 mm", "m", 2e-4),
        ("90 deg", "rad", math.pi / 2),
        ("0.5", "%", 0.5),
        ("50 %", "%", 50.0),
        ("20 mN", "N", 0.02),
        ("0.5 ms", "s", 5e-4),
    ],
)
def test_a_number_has_its_own_unit_or_that_of_the_option(text, unit, value):
    assert amount(text, unit, "--option") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["", "mm", "16 N", "16 deg", "16 furlong", "nan", "inf mm", "1 2 mm", "1e mm", "16 mm mm"]
)
def test_what_is_no_length_is_refused(text):
    with pytest.raises(
        InputError, match=r"--option: found .*; expected: a number, in mm or with a unit: mm, cm, m, um"
    ):
        amount(text, "mm", "--option")


def test_bounds_are_in_the_options_unit():
    assert amount("1 cm", "mm", "--gap", least=0, most=10) == 10.0
    with pytest.raises(InputError, match=r"--gap: found '1.1 cm'.*at least 0 and at most 10"):
        amount("1.1 cm", "mm", "--gap", least=0, most=10)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:20:4", [0, 20, 4]),
        ("0:2:0.4 cm", [0, 20, 4]),
        ("0:2 cm:0.4", [0, 20, 4]),
        ("0 cm:2:4 mm", [0, 2, 4]),
        ("0 mm:2 cm:0.4", [0, 20, 4]),
        ("0 cm:20", [0, 200]),
        ("0:20 mm:0.4 cm", [0, 20, 4]),
        ("0:2 m:20 N", []),
        ("0:x:1 cm", []),
    ],
)
def test_parts_without_a_unit_have_the_last_that_is_written(text, expected):
    assert amounts_in(text.split(":"), "mm") == pytest.approx(expected)


def test_a_list_with_what_looks_like_a_decimal_comma_is_refused():
    for text in ("1,5 cm", "-0,25mm", "12,5 mm "):
        with pytest.raises(InputError, match=r"--gap: found .*a decimal point, -?\d+\.\d+ .m, or two amounts"):
            listed(text, "mm", "--gap")
    for text in ("1, 5 cm", "1 cm,5 cm", "10,50", "1.0,5 cm"):
        assert listed(text, "mm", "--gap") == pytest.approx([10, 50]), text
    assert listed("0,1 cm,5 mm", "mm", "--gap") == pytest.approx([0, 10, 5])


def test_an_option_without_a_unit_takes_plain_numbers_alone():
    assert amounts_in(["1", "2"], "") == [1, 2]
    assert amounts_in(["1 mm"], "") == []
    assert amounts_in(["46 %"], "") == []


def test_parts_of_an_amount():
    assert number_and_unit("3e-1mm") == (0.3, "mm")
    assert number_and_unit("3 mm 4") is None
    assert units_beside("deg") == pytest.approx({"deg": 1.0, "rad": 180 / math.pi})


def unit_of(name: str) -> str:
    return {"L1": "m", "K1": "N/m"}.get(name, "")


def test_numbers_by_name_have_the_units_of_their_names():
    given = ["L1=30:50 mm", "K1=100:200", "share=0.1:inf"]
    found = numbers_by_name(given, "--bounds", "such", (2,), unit_of)
    assert found == {"L1": pytest.approx((0.03, 0.05)), "K1": (100.0, 200.0), "share": (0.1, math.inf)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("L1=3:4 N", "each once, in m or with a unit: mm, cm, m, um"),
        ("K1=1:2 mm", "each once, in N/m$"),
        ("share=1:2 mm", "each once$"),
    ],
)
def test_units_of_another_kind_are_refused_by_name(text, words):
    with pytest.raises(InputError, match=words):
        numbers_by_name([text], "--bounds", "such", (2,), unit_of)
