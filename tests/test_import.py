"""`import pftwin` is light, complete, and leaves JAX alone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import pftwin


def run(code: str) -> str:
    bare = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120, env=bare
    )
    return done.stdout.strip()


def test_import_loads_nothing_heavy():
    heavy = ["jax", "equinox", "numpy", "scipy", "matplotlib", "xarray", "pandas", "trimesh", "diffrax", "ezc3d"]
    assert run(f"import sys, pftwin; print([m for m in {heavy} if m in sys.modules])") == "[]"


def test_importing_leaves_jax_settings_alone():
    code = (
        "import os, jax, pftwin, fitting\n"
        "pftwin.Measured, pftwin.InputError, pftwin.__version__\n"
        "print(jax.config.jax_enable_x64, 'XLA_FLAGS' in os.environ)"
    )
    assert run(code) == "False False"


def test_simulation_modules_do_not_import_figures_or_datasets():
    heavy = ["matplotlib", "xarray", "pandas", "trimesh", "diffrax", "ezc3d"]
    names = "pftwin.simulate, pftwin.Result, pftwin.Scene, pftwin.validate, pftwin.plots, pftwin.Measured"
    assert run(f"import sys, pftwin; {names}; print([m for m in {heavy} if m in sys.modules])") == "[]"


@pytest.mark.parametrize("name", pftwin.__all__)
def test_every_public_name_is_there(name):
    assert getattr(pftwin, name) is not None
    assert name in dir(pftwin)


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        pftwin.simulat  # noqa: B018


def test_version_is_text():
    assert isinstance(pftwin.__version__, str)
    assert pftwin.__version__
