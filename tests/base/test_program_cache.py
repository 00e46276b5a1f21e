"""Compiled programs: kept for the next process, and never used where anything that decides them has changed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import pftwin
from pftwin.base import cache_folder as folder
from pftwin.base.program_cache import Program, shares_settings
from pftwin.base.spatial import Vec3, safe_sqrt
from pftwin.dynamics.frame_states import at_start
from pftwin.dynamics.simulate import simulate

PACKAGE = Path(pftwin.__file__).parent
COUNT = """
import json, os, sys
import numpy as np
import pftwin
pftwin.configure(cache_dir=sys.argv[1], float64=sys.argv[2] != "single")
import jax
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
events, misses = [], []
jax.monitoring.register_event_listener(lambda event, **about: misses.append(event.endswith("/cache_misses")))
jax.monitoring.register_event_duration_secs_listener(lambda event, _, **about: events.append(event.rsplit("/")[-1]))
"""
TINY = (
    COUNT
    + """
from pftwin.base.program_cache import Program
from pftwin.base.spatial import safe_sqrt
place = os.path.join(sys.argv[1], "programs")
before = len(os.listdir(place)) if os.path.isdir(place) else 0
answer = Program(safe_sqrt).timed(np.array([4.0, 9.0])).answer
traced = len(os.listdir(os.path.join(sys.argv[1], "programs"))) - before
print(json.dumps([traced > 0, sum(misses), answer.tolist()]))
"""
)
RIG = (
    COUNT
    + """
result = pftwin.simulate(pftwin.rig.case(1, contact="P5"), dt=1e-2)
parts = [result.center, result.quaternion, result.energies.total, result.energies.heat, result.equilibrium.eigenvalues]
parts += [v for report in result.effects.values() for v in report.values()]
heavy = [m for m in ("trimesh", "scipy.signal") if m in sys.modules]
print(json.dumps([sum(misses), heavy, b"".join(p.tobytes() for p in parts).hex()]))
"""
)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """A copy of pftwin, so that processes one after the other run the same source, whoever edits it meanwhile."""
    copy = tmp_path_factory.mktemp("source") / "pftwin"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


def process(script: str, cache: Path, package: Path, *, kind: str = "double", flags: str = "") -> list:
    """What a fresh process prints."""
    env = {**os.environ, "PYTHONPATH": str(package.parent), "XLA_FLAGS": flags}
    done = subprocess.run(
        [sys.executable, "-c", script, str(cache), kind],
        capture_output=True,
        text=True,
        check=False,
        env=env,
        cwd=cache.parent,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_second_process_gives_the_same_bits_without_compiling(tmp_path, package):
    compiled, heavy, first = process(RIG, tmp_path / "cache", package)
    assert compiled >= 2
    assert heavy == ["trimesh", "scipy.signal"]
    compiled, heavy, second = process(RIG, tmp_path / "cache", package)
    assert compiled == 0
    assert heavy == []
    assert len(first) > 16 * 721 * 10
    assert second == first


@pytest.fixture(scope="module")
def filled(tmp_path_factory, package) -> Path:
    """The cache folder of a first process, and a copy beside it."""
    cache = tmp_path_factory.mktemp("filled") / "cache"
    assert process(TINY, cache, package) == [True, 1, [2.0, 3.0]]
    shutil.copytree(cache, cache.with_name("kept"))
    return cache


class TestChanges:
    """A small program in processes of its own."""

    @pytest.fixture
    def cache(self, filled):
        """As the first process left it, at the same place, which is part of the keys of JAX's cache."""
        shutil.rmtree(filled)
        return shutil.copytree(filled.with_name("kept"), filled)

    def test_nothing_changed(self, cache, package):
        assert process(TINY, cache, package) == [False, 0, [2.0, 3.0]]

    def test_other_compiler_flags(self, cache, package):
        assert process(TINY, cache, package, flags="--xla_cpu_prefer_vector_width=128") == [False, 1, [2.0, 3.0]]

    def test_single_precision(self, cache, package):
        assert process(TINY, cache, package, kind="single") == [True, 1, [2.0, 3.0]]

    @pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b""])
    def test_a_damaged_file(self, cache, package, damage):
        (path,) = (cache / "programs").iterdir()
        whole = path.read_bytes()
        path.write_bytes(damage(whole))
        assert process(TINY, cache, package)[1:] == [0, [2.0, 3.0]]
        assert path.read_bytes() == whole  # mended

    def test_changed_source(self, cache, package, tmp_path):
        copy = shutil.copytree(package, tmp_path / "pftwin", ignore=shutil.ignore_patterns("__pycache__", "data"))
        assert process(TINY, cache, copy) == [False, 0, [2.0, 3.0]]  # the same source at another place
        spatial = copy / "base" / "spatial.py"
        text = spatial.read_text()
        spatial.write_text(text + "\n# a remark\n")
        assert process(TINY, cache, copy) == [True, 0, [2.0, 3.0]]  # traced: it proves to be the same program
        old = "return jnp.where(positive, jnp.sqrt("
        assert old in text
        spatial.write_text(text.replace(old, old.replace("jnp.sqrt(", "2 * jnp.sqrt(")))
        assert process(TINY, cache, copy) == [True, 1, [4.0, 6.0]]


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setattr(pftwin, "imported_at", np.inf)  # whoever edits the source while this runs
    before = folder.chosen()
    folder.use_cache_folder(tmp_path)
    yield tmp_path
    folder.use_cache_folder(before)


def test_arrays_are_variables_and_all_else_is_fixed(place):
    power = Program(Vec3.__mul__)
    v = Vec3(*(jnp.asarray(float(i)) for i in range(3)))
    first, again = power.timed(v, 2.0), power.timed(-v, 2.0)
    assert first.preparation > 0
    assert again.preparation == 0
    assert [float(first.answer.z), float(again.answer.z)] == [4.0, -4.0]
    other = power.timed(v, 3.0)
    assert other.preparation > 0
    assert float(other.answer.z) == 6.0
    assert isinstance(other.answer, Vec3)


def test_debugging_is_not_left_out(place):
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        Program(Vec3.__mul__)(Vec3(*(jnp.asarray(np.nan) for _ in range(3))), 2.0)


def test_functions_and_effects_from_elsewhere_are_compiled_but_not_kept(place):
    assert float(Program(lambda x: 2 * x)(jnp.asarray(1.0))) == 2.0
    assert not [path for path in place.rglob("*") if path.is_file()]


def test_a_program_copied_over_another_s_name_is_not_run(place):
    """Both take a vector and give one: nothing but the name tells them apart."""
    v = Vec3(*(jnp.asarray(float(i)) for i in range(3)))
    Program(Vec3.__mul__)(v, 2.0)
    (twice,) = (place / "programs").iterdir()
    Program(Vec3.__mul__)(v, 3.0)
    (thrice,) = set((place / "programs").iterdir()) - {twice}
    thrice.write_bytes(twice.read_bytes())
    assert float(Program(Vec3.__mul__)(v, 3.0).z) == 6.0
    assert thrice.read_bytes() != twice.read_bytes()  # mended


def test_programs_are_shared_by_processes_of_one_device_and_of_two(package, tmp_path):
    """A process that counts the CPU as two does not trace again. JAX's cache has a file for each number of devices."""
    two = TINY.replace("configure(", "configure(cpu_devices=2, ")
    traced = []
    for code in (TINY, two):
        command = [sys.executable, "-c", code, str(tmp_path / "kept"), "double"]
        environment = {**os.environ, "PYTHONPATH": str(package.parent)}
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=environment)
        assert done.returncode == 0, done.stderr
        traced.append(json.loads(done.stdout.splitlines()[-1]))
    assert traced[0][0]
    assert not traced[1][0]
    assert traced[0][2] == traced[1][2] == [2.0, 3.0]


def test_transformations_go_through():
    root = Program(safe_sqrt)
    x = jnp.asarray([4.0, 9.0])
    assert np.allclose(jax.vmap(root)(x), [2, 3])
    assert float(jax.grad(root)(x[0])) == 0.25


@pytest.mark.slow
def test_timing_tells_preparation_from_running():
    scene = small_scene(11)
    scene = eqx.tree_at(lambda s: s.patella.mass, scene, 1.01 * scene.patella.mass)
    simulate(scene, dt=2e-3)
    warm = simulate(scene, dt=2e-3).timing
    assert warm["compile_s"] == 0
    assert 0 < warm["run_s"] < 1
    assert 0 < warm["equilibrium_s"] < 1


def test_a_program_can_be_prepared_from_shapes():
    """It is then the one that runs: for arrays of that kind nothing is left to compile, for others everything."""
    scaled = Program(lambda x, n: x * n)
    assert not scaled.at_hand(jnp.ones(3), 2)
    scaled.prepare(jax.ShapeDtypeStruct((3,), jnp.dtype(float)), 2)
    assert scaled.at_hand(jnp.ones(3), 2)
    assert not scaled.at_hand(jnp.ones(4), 2)
    ready = scaled.timed(jnp.ones(3), 2)
    assert ready.preparation == 0
    np.testing.assert_array_equal(ready.answer, 2 * np.ones(3))


@pytest.mark.slow
def test_both_programs_of_a_first_simulation_are_those_that_were_compiled_side_by_side():
    scene = small_scene(9)
    simulate_module = sys.modules["pftwin.dynamics.simulate"]
    before = len(simulate_module._run._ready)
    first = simulate(scene, dt=3e-3)
    assert len(simulate_module._run._ready) == before + 1
    assert first.timing["compile_s"] > 0
    assert simulate(scene, dt=3e-3).timing["compile_s"] == 0


def test_starts_of_recordings_of_any_length_take_one_program():
    simulate_module = sys.modules["pftwin.dynamics.simulate"]
    longer, shorter = (pftwin.equilibrium(small_scene(n)) for n in (12, 5))
    np.testing.assert_allclose(shorter.position, longer.position, rtol=1e-9)  # of other splines
    assert all(simulate_module._solve.at_hand(at_start(small_scene(n).unnamed())) for n in (12, 5, 7))


def test_what_is_being_compiled_is_not_traced_and_compiled_again():
    """Whoever needs it first does it; the other one waits, and finds it done."""
    traced = []

    def scaled(x):
        traced.append(x.shape)
        return 2 * x

    program, both = Program(scaled), Barrier(2)

    def begun():
        both.wait()
        return program.begin(jnp.ones(3))

    with ThreadPoolExecutor(2) as threads:
        first, second = (done.result() for done in [threads.submit(begun), threads.submit(begun)])
        assert traced == [(3,)]
        first()
        ready = next(iter(program._ready.values()))
        for done in (threads.submit(second), threads.submit(first)):
            done.result()
    assert next(iter(program._ready.values())) is ready
    assert program.timed(jnp.ones(3)).preparation == 0
    assert program(jnp.ones(4)).shape == (4,)
    assert traced == [(3,), (4,)]


def test_threads_do_not_share_what_a_with_statement_sets():
    with ThreadPoolExecutor(1) as threads:
        assert shares_settings(threads)
        with jax.default_matmul_precision("highest"):
            assert not shares_settings(threads)
        with jax.disable_jit():
            assert not shares_settings(threads)
