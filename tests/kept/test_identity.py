"""Texts by which things are found: alike for alike things, different for different ones, refused where in doubt."""

from __future__ import annotations

import enum
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest
from small_scene import small_scene

from pftwin.effects.damping import LinearDamping
from pftwin.kept.identity import CannotKeepError, digest, structure_text, value_text
from pftwin.spatial import Vec3


class Mine(NamedTuple):
    a: int


class Colour(enum.Enum):
    RED = 1


def test_values_that_differ_have_texts_that_differ():
    values = [
        None, True, 1, 1.0, 1 + 0j, "1", b"1", (), [], (1,), [1], ((1,),), (1, 2), ("1, 2",), {1: 2}, {"1": 2}, 0.0,
        -0.0, float("nan"), {1}, frozenset({1}), np.ones(2), np.ones(3), np.ones(2, np.float32), np.zeros(2),
        np.ones((2, 1)), np.float64(1), np.float32(1), Vec3,
    ]  # fmt: skip
    assert len({value_text(v) for v in values}) == len(values)


def test_sets_have_one_order():
    assert value_text({"a", "b", "c"}) == value_text({"c", "b", "a"})


def test_parts_do_not_run_together():
    assert digest(("ab", "c")) != digest(("a", "bc"))


@pytest.mark.parametrize("value", [lambda: 0, object(), Mine(1), Mine, Colour.RED, np.array([None]), (1, object())])
def test_what_cannot_be_told_apart_is_refused(value):
    with pytest.raises(CannotKeepError):
        value_text(value)


def test_a_scene_has_a_text_that_holds_its_structure_and_not_its_numbers():
    scene = small_scene().unnamed()
    text = structure_text(jax.tree.structure(scene))
    stiffer = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, 2 * scene.effects[1].stiffness)
    assert structure_text(jax.tree.structure(stiffer)) == text
    assert structure_text(jax.tree.structure(scene.without("gravity"))) != text
    damping = [LinearDamping(0.1, 1e-4, body=body, name="d") for body in ("femur", "tibia")]
    texts = {structure_text(jax.tree.structure(scene.with_effect(d))) for d in damping}
    assert len(texts) == 2


def test_an_effect_from_elsewhere_is_refused():
    class Own(LinearDamping):
        pass

    scene = small_scene().with_effect(Own(0.1, 1e-4, name="own"))
    with pytest.raises(CannotKeepError, match="Own"):
        structure_text(jax.tree.structure(scene))
