"""The faces of packages: every name that they promise is there, and type checkers know the same names."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest

import fitting
import pftwin

FACES = {
    "pftwin": pftwin,
    "pftwin.effects": pftwin.effects,
    "pftwin.interchange": pftwin.interchange,
    "pftwin.rig": pftwin.rig,
    "pftwin.surfaces": pftwin.surfaces,
    "fitting": fitting,
}


def names_for_type_checkers(module) -> set[str]:
    """What the module imports under TYPE_CHECKING."""
    tree = ast.parse(Path(inspect.getsourcefile(module) or "").read_text(encoding="utf-8"))
    (block,) = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    imports = [n for n in block.body if isinstance(n, ast.ImportFrom)]
    return {a.asname or a.name for n in imports for a in n.names} | (
        {"__version__"} if any(isinstance(n, ast.AnnAssign) for n in block.body) else set()
    )


@pytest.mark.parametrize("name", FACES)
def test_every_name_is_there_and_known_to_type_checkers(name):
    module = FACES[name]
    assert dir(module) == sorted(module.__all__)
    assert all(getattr(module, n) is not None for n in module.__all__)
    assert set(module.__all__) == names_for_type_checkers(module)


@pytest.mark.parametrize("name", FACES)
def test_another_name_is_no_attribute_of_the_face(name):
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'Tendom'"):
        FACES[name].Tendom  # noqa: B018
