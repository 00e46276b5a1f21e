"""Test-wide settings: float64, strict promotion, a persistent compilation cache, and where the real data are."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import hypothesis
import jax
import pytest

from pftwin.base.runtime import configure

_ROOT = Path(__file__).resolve().parents[1]
configure(cache_dir=os.environ.get("PFTWIN_TEST_CACHE", str(_ROOT / ".jax_cache")))
# What `simulate` and its like compile is stored as for users, under a name that does not show a constant that a test
# has replaced: a test that replaces one traces a function of its own.
# Single operations too are kept: both processes of a run need them, some thousands, each of a thirtieth of a second.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_traceback_in_locations_limit", 0)  # where an operation was written: nobody reads it in a program
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
hypothesis.settings.register_profile("pftwin", deadline=None)  # a busy machine is no failure
hypothesis.settings.load_profile("pftwin")
gc.set_threshold(100_000, 20, 20)  # tracing makes many objects, little garbage: looking for it took a tenth of the time

OPTIMISATION = "--xla_backend_optimization_level"


def pytest_configure(config: pytest.Config) -> None:
    """The default run compiles programs without LLVM's optimisations: it takes half the time, and motions are short.

    XLA's own passes and the switches of `configure` are those of users. Slow tests, the demo and the benchmarks run
    with all optimisations, and so does any run with a level of its own in XLA_FLAGS:
    XLA_FLAGS=--xla_backend_optimization_level=3 python -m pytest
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "not slow" in config.option.markexpr and OPTIMISATION not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {OPTIMISATION}=0".strip()


# Files that take large programs of another file (test_fit_tendons.py, test_glb.py) not far from them in the order of
# names: both processes of a run could come to them at the same time, and each would compile them.
LATER = ("test_measured_faults.py", "test_drawn_lines.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The hard cases first: they are one file of half an hour, which would have one process to itself at the end."""
    items.sort(key=lambda item: (item.path.name != "test_matrix.py", item.path.name in LATER))


@pytest.fixture(scope="session")
def dm_knee() -> Path:
    """The folder of the DM implant's files; the test is skipped, with the reason, where it is absent."""
    return _data("dm_knee")


@pytest.fixture(scope="session")
def healthy_knee() -> Path:
    """The folder of a living knee's files; the test is skipped, with the reason, where it is absent."""
    return _data("healthy_knee")


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small knee's files, `scene.toml` among them."""
    from toy_scene_files import write_toy

    folder = tmp_path_factory.mktemp("toy")
    write_toy(folder)
    return folder


def _data(name: str) -> Path:
    folder = Path(os.environ.get("PFTWIN_DATA", _ROOT.parent / "shared" / "data")) / name
    if not folder.is_dir():
        pytest.skip(f"no data at {folder}: set PFTWIN_DATA to the folder that holds {name}/")
    return folder


MOST_MEMORY = 5e9  # bytes of a test process from which on compiled programs are dropped
_limit = {"now": MOST_MEMORY}


@pytest.fixture(scope="module", autouse=True)
def _bounded_memory():
    """Compiled programs pile up over a thousand tests: past a limit those of finished modules go.

    The system does not get all of their memory back: the limit is then a third higher than what was left, or everything
    would be compiled anew for each of the modules that follow.
    """
    yield
    if _memory() > _limit["now"]:
        jax.clear_caches()
        gc.collect()
        _limit["now"] = max(MOST_MEMORY, 4 / 3 * _memory())


def _memory() -> int:
    """Of this process [bytes]; 0 where the system does not say."""
    status = Path("/proc/self/statm")
    return int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if status.is_file() else 0
