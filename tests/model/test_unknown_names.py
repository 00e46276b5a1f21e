"""Errors about names of a scene's parameters begin with what was called."""

from __future__ import annotations

import pytest
from small_scene import small_scene

import fitting
import pftwin


@pytest.mark.parametrize("name", ["quadriceps.stifness", "K9", "quadriceps.stiffness[3]", "nothing[:]", "K1~nothing"])
def test_what_was_called_is_named(name: str) -> None:
    scene = small_scene(5)
    for called, call in (
        ("scene.get", lambda: scene.get(name)),
        ("scene.set", lambda: scene.set(name, 1.0)),
        ("free", lambda: fitting.free_parameters(scene, [name])),
    ):
        with pytest.raises(pftwin.InputError, match=rf"^{called}: .*{name.split('[')[0].split('~')[-1]}"):
            call()


def test_the_shape_of_a_value_is_refused_by_the_name_of_its_parameter() -> None:
    with pytest.raises(pftwin.InputError, match=r"^K1: found shape \(2,\); expected: shape \(\)"):
        small_scene(5).set("K1", [1.0, 2.0])
