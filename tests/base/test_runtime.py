"""Settings of the process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest

from pftwin.base import cache_folder, runtime
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.runtime import FAST_CPU, VECTOR_WIDTH, fast_cpu_flags
from pftwin.cli import terminal

FAST = f"{VECTOR_WIDTH} --xla_backend_extra_options={','.join(FAST_CPU)}"


def test_fast_cpu_flags_are_added_once():
    assert fast_cpu_flags() == FAST
    assert fast_cpu_flags(FAST) == FAST


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--xla_dump_to=here", f"--xla_dump_to=here {FAST}"),
        ("--xla_cpu_prefer_vector_width=256", FAST.replace("512", "256")),
        ("--xla_backend_extra_options=a", FAST.replace("options=", "options=a,")),
        (
            f"--xla_backend_extra_options={FAST_CPU[1].split('=')[0]}=9",
            FAST.replace(",".join(FAST_CPU), f"{FAST_CPU[1].split('=')[0]}=9,{FAST_CPU[0]}"),
        ),
    ],
)
def test_what_the_user_chose_stays(given, expected):
    assert fast_cpu_flags(given) == expected


def test_xla_takes_the_flags():
    """XLA ends a process that gives it an unknown flag."""
    code = "import os, pftwin; pftwin.configure(); import jax.numpy as jnp; print(float(jnp.ones(2).sum()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.strip() == "2.0", done.stderr


def test_too_late_is_an_error():
    code = "import os; os.environ.pop('XLA_FLAGS', None); import jax; jax.devices(); import pftwin; pftwin.configure()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert "JAX has already computed something" in done.stderr


def test_switches_may_stand_in_any_order(monkeypatch):
    """Those of other people in front, between or behind: nothing has to be switched on any more."""
    words = runtime.fast_cpu_flags("--xla_some_switch=1").split()
    monkeypatch.setenv("XLA_FLAGS", " ".join(reversed(words)))
    monkeypatch.setattr(runtime, "_jax_has_started", lambda: True)
    runtime.configure()
    assert os.environ["XLA_FLAGS"].split() == words[::-1]


SAY = """
import json, os, warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    %s
import jax
print(json.dumps([jax.config.jax_enable_x64, os.environ.get("XLA_FLAGS", ""), [str(w.message) for w in caught]]))
"""


def said(*lines: str, **environment: str) -> tuple[bool, str, list[str]]:
    """In a fresh process: double precision or not, the flags, and warnings."""
    bare = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    code = SAY % "\n    ".join(lines)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120, env=bare | environment
    )
    assert done.returncode == 0, done.stderr
    return tuple(json.loads(done.stdout))


@pytest.mark.parametrize(("asked", "used"), [(True, "command_lines"), (False, None), ("own", "own")])
def test_true_is_the_command_lines_cache_folder(asked, used, monkeypatch, tmp_path):
    chosen = []
    monkeypatch.setattr(cache_folder, "use_cache_folder", lambda folder: chosen.append(str(folder)))
    monkeypatch.setenv("PFTWIN_CACHE", str(tmp_path / "command_lines"))
    runtime.configure(cache_dir=str(tmp_path / "own") if asked == "own" else asked)
    assert chosen == ([] if used is None else [str(tmp_path / used)])


class TestDefaults:
    """Programs that never call `configure`, and those that call it late."""

    @pytest.mark.parametrize("first", ["import pftwin; pftwin.rig", "import jax, pftwin; pftwin.simulate"])
    def test_the_first_use_is_fast_and_precise(self, first):
        assert said(first) == (True, FAST, [])

    @pytest.mark.slow
    def test_fitting_too(self):
        assert said("import fitting", "fitting.fit_tendons")[:2] == (True, FAST)

    def test_too_late_is_said_once_with_figures(self):
        double, flags, warned = said(
            "import jax", "jax.devices()", "import pftwin", "pftwin.rig", "pftwin.simulate", "pftwin.effects"
        )
        assert (double, flags) == (False, "")
        assert len(warned) == 2
        assert "26 times longer" in warned[0]
        assert "float32" in warned[1]
        assert all("pftwin.configure()" in text for text in warned)

    def test_too_late_for_speed_alone(self):
        _, _, warned = said("import jax", "jax.devices()", "import pftwin", "pftwin.rig", JAX_ENABLE_X64="1")
        assert len(warned) == 1
        assert "26 times longer" in warned[0]

    def test_a_choice_made_first_wins(self):
        first = said("import pftwin", "pftwin.configure(float64=False, fast_cpu=False)", "pftwin.rig")
        assert first == (False, "", [])

    def test_a_choice_made_before_jax_starts_replaces_the_defaults(self):
        late = said("import pftwin", "pftwin.rig", "pftwin.configure(float64=False, fast_cpu=False)")
        assert late == (False, "", [])

    def test_the_users_own_switches_stay(self):
        own = f"--xla_backend_extra_options={FAST_CPU[1].split('=')[0]}=9"
        _, flags, warned = said("import pftwin", "pftwin.rig", XLA_FLAGS=own)
        assert flags == fast_cpu_flags(own)
        assert len(warned) == 1
        assert "xla_cpu_small_while_loop_byte_threshold, which stays" in warned[0]

    def test_the_users_single_precision_stays_and_is_said(self):
        double, _, warned = said("import pftwin", "pftwin.rig", JAX_ENABLE_X64="0")
        assert not double
        assert len(warned) == 1
        assert "float32" in warned[0]

    @pytest.mark.parametrize("version", ["0.5.3", "0.11.0", "1.0.0"])
    def test_an_untested_jaxlib_gets_no_flags(self, version):
        """XLA ends a process that gives it a flag that it does not know."""
        for use in ("pftwin.rig", "pftwin.configure()"):
            _, flags, warned = said(
                "import pftwin", "from pftwin.base import runtime", f"runtime.version = lambda _: {version!r}", use
            )
            assert flags == ""
            assert len(warned) == 1
            assert f"jaxlib {version} is not one of those tested" in warned[0]

    def test_the_versions_are_those_of_the_project_file(self):
        project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
        (pin,) = [d for d in project["project"]["dependencies"] if d.startswith("jax>")]
        floor, ceiling = (".".join(map(str, bound)) for bound in runtime.TESTED)
        assert pin == f"jax>={floor},<{ceiling}"

    @pytest.mark.parametrize("use", ["", "jax.devices();"])
    def test_asking_whether_jax_has_started_does_not_start_it(self, use):
        code = (
            f"import jax; {use} from pftwin.base.runtime import _jax_has_started as asked; first = asked(), asked();"
            "own = jax.config.jax_num_cpu_devices; jax.devices(); print(*first, asked(), own)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
        started = bool(use)
        assert done.stdout.split() == [str(started), str(started), "True", "-1"]


def test_that_an_accelerator_is_slow_at_single_motions_is_said_once(monkeypatch):
    monkeypatch.setattr(runtime._Process, "warned_of_accelerator", False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.warn_of_accelerator("cpu")
        with pytest.raises(PftwinWarning, match=r"on a GPU here.*JAX_PLATFORMS=cpu,cuda"):
            runtime.warn_of_accelerator("gpu")
        runtime.warn_of_accelerator("gpu")


@pytest.mark.parametrize(("given", "devices"), [(None, "all"), ("all", "all"), ("3", 3)])
def test_the_command_line_counts_cpu_devices_by_a_variable(monkeypatch, given, devices):
    monkeypatch.delenv("PFTWIN_DEVICES", raising=False)
    if given is not None:
        monkeypatch.setenv("PFTWIN_DEVICES", given)
    asked = {}
    monkeypatch.setattr(runtime, "configure", lambda **settings: asked.update(settings))
    monkeypatch.setitem(sys.modules, "jax", SimpleNamespace(config=SimpleNamespace(jax_enable_x64=False)))
    terminal.start_computing(batches=True)
    assert asked["cpu_devices"] == devices
    terminal.start_computing()
    assert asked["cpu_devices"] is None


@pytest.mark.parametrize("given", ["0", "-1", "two", ""])
def test_a_variable_that_is_no_number_is_refused(monkeypatch, given):
    monkeypatch.setenv("PFTWIN_DEVICES", given)
    with pytest.raises(InputError, match=r'PFTWIN_DEVICES: found .*; expected: "all", or a whole number, at least 1'):
        terminal.start_computing(batches=True)
