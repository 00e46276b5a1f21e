"""Test-wide settings: float64, strict promotion, a persistent compilation cache, and where the real data are."""

from __future__ import annotations

import os
from pathlib import Path

import jax
import pytest

from pftwin.runtime import configure

_ROOT = Path(__file__).resolve().parents[1]
configure(cache_dir=os.environ.get("PFTWIN_TEST_CACHE", str(_ROOT / ".jax_cache")))
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def dm_knee() -> Path:
    """The folder of the DM implant's files; the test is skipped, with the reason, where it is absent."""
    base = Path(os.environ.get("PFTWIN_DATA", _ROOT.parent / "shared" / "data"))
    folder = base / "dm_knee"
    if not folder.is_dir():
        pytest.skip(f"no DM implant data at {folder}: set PFTWIN_DATA to the folder that holds dm_knee/")
    return folder


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small knee's files, `scene.toml` among them."""
    from toy_scene_files import write_toy

    folder = tmp_path_factory.mktemp("toy")
    write_toy(folder)
    return folder


MOST_MEMORY = 3e9  # bytes of a test process from which on compiled programs are dropped


@pytest.fixture(scope="module", autouse=True)
def _bounded_memory():
    """Compiled programs pile up over a thousand tests: past a limit those of finished modules go."""
    yield
    status = Path("/proc/self/statm")
    if status.is_file() and int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > MOST_MEMORY:
        jax.clear_caches()
