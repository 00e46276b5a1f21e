"""The mutation run itself: its bugs are valid programs that differ, and its map names what exists."""

from __future__ import annotations

import ast

import pytest
from mutate import mutants
from run import ROOT, equivalents, guarded, path_of

TEXT = '''
def f(a: int, b, *, c=2.5) -> "x + y":
    """A docstring - no sum."""
    if not a < b:
        raise ValueError(f"{a + b} is wrong")
    return min(a - b * c, -b, key=abs) if a and g(a, b) else a ** 2
'''


def test_each_operator_makes_its_bug_and_annotations_and_messages_are_left_alone():
    assert {(m.what, m.label()) for m in mutants(TEXT)} == {
        ("sign or not left out", "not a < b -> (a < b)"),
        ("comparison", "a < b -> (a <= b)"),
        ("nothing returned", "min(a - b * c, -b, key=abs) if a and g(a, b) else a ** 2 -> (None)"),
        (
            "branches swapped",
            "min(a - b * c, -b, key=abs) if a and g(a, b) else a ** 2 -> "
            "(a ** 2 if a and g(a, b) else min(a - b * c, -b, key=abs))",
        ),
        ("another function", "min(a - b * c, -b, key=abs) -> (max(a - b * c, -b, key=abs))"),
        ("operator", "a - b * c -> (a + b * c)"),
        ("factor or summand left out", "a - b * c -> (a)"),
        ("operator", "b * c -> (b / c)"),
        ("factor or summand left out", "b * c -> (b)"),
        ("sign or not left out", "-b -> (b)"),
        ("and for or", "a and g(a, b) -> (a or g(a, b))"),
        ("arguments swapped", "g(a, b) -> (g(b, a))"),
        ("power left out", "a ** 2 -> (a)"),
        ("constant", "2 -> (3)"),
        ("constant", "2.5 -> (3.75)"),
    }


def test_a_constant_that_only_keeps_a_division_from_0_by_0_stays():
    found = {m.label() for m in mutants("x = a / where(b > 0, b, 1.0) + where(b > 0, b, 2.5)\n")}
    assert "1.0 -> (1.5)" not in found
    assert {"b > 0 -> (b >= 0)", "2.5 -> (3.75)"} <= found


def test_every_bug_is_a_program_of_its_own_whatever_letters_stand_before_it():
    text = 'äöü = "äöü"; x = (1 + len(äöü)) * 2\n'
    found = {m.applied(text) for m in mutants(text)}
    assert 'äöü = "äöü"; x = ((1 + len(äöü)) / 2)\n' in found
    assert text not in found
    assert all(ast.parse(f) for f in found)


@pytest.mark.parametrize("module", sorted(guarded()))
def test_guarded_modules_can_be_mutated(module):
    text = (ROOT / path_of(module)).read_text(encoding="utf-8")
    found = mutants(text)
    assert found
    assert all(ast.parse(m.applied(text)) for m in found[:: max(1, len(found) // 20)])


def test_what_is_called_equivalent_is_still_there():
    for module, label, line in equivalents():
        text = (ROOT / path_of(module)).read_text(encoding="utf-8")
        assert (label, line) in {(m.label(), m.text_of_line(text)) for m in mutants(text)}, f"{module}: {label}"
