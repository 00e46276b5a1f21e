"""The product uses what libraries document: no private module or name of another library."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import fitting
import pftwin

OWN = ("pftwin", "fitting")
NOT_FOR_US = {"jax.config.values", "jax.interpreters.partial_eval.dce_jaxpr", "jax.interpreters.partial_eval"}
FILES = [(Path(p.__path__[0]), f) for p in (pftwin, fitting) for f in sorted(Path(p.__path__[0]).rglob("*.py"))]


def is_private(name: str) -> bool:
    return name in NOT_FOR_US or any(p.startswith("_") and not p.endswith("__") for p in name.split(".")[1:])


def used(text: str) -> list[str]:
    """The full names of what a file takes from other libraries."""
    tree, modules, names = ast.parse(text), {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for a in node.names:
                modules[a.asname or a.name.split(".")[0]] = a.name if a.asname else a.name.split(".")[0]
                names.append(a.name)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            for a in node.names:
                modules[a.asname or a.name] = f"{node.module}.{a.name}"
                names.append(f"{node.module}.{a.name}")
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            parts, inner = [], node
            while isinstance(inner, ast.Attribute):
                parts.append(inner.attr)
                inner = inner.value
            if isinstance(inner, ast.Name) and inner.id in modules:
                names.append(".".join([modules[inner.id], *reversed(parts)]))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "._src" in node.value:
            names.append(node.value)
    return [n for n in names if n.split(".")[0] not in (*OWN, *sys.stdlib_module_names)]


@pytest.mark.parametrize(
    "text",
    [
        "import jax._src.core",
        "from jax._src import distributed",
        "import jax\njax.config.values",
        "from jaxlib._jax import x",
        "import jax as j\nj._src.core.x",
        "from jax.interpreters import partial_eval",
        "import sys\nsys.modules['jax._src.xla_bridge']",
        "import numpy as np\nnp._core.x",
    ],
)
def test_private_names_are_found(text):
    assert any(is_private(name) for name in used(text))


def test_no_file_uses_private_names_of_other_libraries():
    found = {(str(f.relative_to(root)), n) for root, f in FILES for n in used(f.read_text()) if is_private(n)}
    assert found == set()
