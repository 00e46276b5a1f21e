"""Kept values are data: they come back bit for bit, and no content of a file makes reading run code."""

from __future__ import annotations

import ast
import enum
import io
import json
import pickle
import zipfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import fitting
import pftwin
from pftwin.base import cache_folder as folder
from pftwin.base.errors import PftwinWarning
from pftwin.base.serialization import NotPlainError, fingerprint, from_bytes, to_bytes


def content(text: object, *arrays: np.ndarray) -> bytes:
    """Bytes as `packed` makes them, of any text."""
    file = io.BytesIO()
    np.savez(file, np.frombuffer(json.dumps(text).encode(), np.uint8), *arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "value",
    [
        None, True, -3, 0.1, float("inf"), "text", [1, (2.0, None)], {"a": [1], 2: "b"}, (), Path("folder/file"),
        np.float32(0.1), np.int64(4),
    ],
)  # fmt: skip
def test_plain_values_come_back(value):
    again = from_bytes(to_bytes(value))
    assert again == value
    assert type(again) is type(value)


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3), np.zeros((0, 3)), np.array([True]), np.array(1j)])
def test_arrays_come_back(array):
    again = from_bytes(to_bytes([array, array]))
    np.testing.assert_array_equal(again[0], array)
    assert again[0].dtype == array.dtype
    assert again[0].shape == array.shape
    assert again[0].flags.writeable


def test_arrays_of_jax_come_back():
    strong = jnp.asarray(2.0, dtype=float)
    assert from_bytes(to_bytes([strong]))[0].aval == strong.aval


def test_a_scene_comes_back():
    scene = small_scene(11)
    again = from_bytes(to_bytes(scene))
    assert type(again) is type(scene)
    assert again.name == scene.name
    assert jax.tree.structure(again) == jax.tree.structure(scene)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(scene), strict=True):
        np.testing.assert_array_equal(a, b)


class Colour(enum.Enum):
    RED = 1


@pytest.mark.parametrize(
    "value",
    [len, object(), np.array([object()]), {1, 2}, jax.random.key(0), lambda: None, jnp.asarray(2.0), Colour.RED],
)
def test_values_that_are_no_plain_data_are_refused(value):
    with pytest.raises(NotPlainError):
        to_bytes([value])


class Sprung:
    """Unpickling it writes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_a_pickle_in_a_stored_file_is_not_executed(tmp_path):
    sprung = pickle.dumps(Sprung(tmp_path / "run"))
    pickle.loads(sprung)
    (tmp_path / "run").unlink()  # so it does run where it is unpickled
    array = io.BytesIO()
    np.savez(array, np.array([Sprung(tmp_path / "run")], dtype=object))
    for body in (sprung, array.getvalue()):
        with pytest.raises(ValueError, match="allow_pickle="):
            from_bytes(body)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "node",
    [
        ["fields", "subprocess:Popen", ["args"], ["true"]],
        ["fields", "pftwin.base.cache_folder:os.system", [], []],
        ["fields", "pftwin.base.cache_folder:Path", [], []],
        ["fields", "pftwin.base.errors:InputError", [], []],
        ["fields", "pftwin.base.spatial:Vec3", ["__class__"], [1]],
        ["named", "pftwin.base.spatial:Vec3", 1],
        ["array", 7],
        ["call", "os.system"],
        [],
    ],
)
def test_no_other_type_is_made(node):
    with pytest.raises((ValueError, TypeError, KeyError, IndexError, AttributeError, ImportError)):
        from_bytes(content(node, np.zeros(1)))


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b.replace(b"0123", b"0124")])
def test_damaged_bytes_are_noticed(damage):
    body = to_bytes(["text 0123", np.arange(100.0)])
    with pytest.raises((ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile)):
        from_bytes(damage(body))


def test_values_that_differ_have_fingerprints_that_differ():
    values = [
        None, True, 1, 1.0, "1", (), [], (1,), [1], ((1,),), (1, 2), ("1, 2",), {1: 2}, {"1": 2}, 0.0, -0.0,
        float("nan"), np.ones(2), np.ones(3), np.ones(2, np.float32), np.zeros(2), np.ones((2, 1)), np.float64(1),
        np.float32(1), jnp.ones(2), ["array", 1], ("ab", "c"), ("a", "bc"),
        jax.ShapeDtypeStruct((2,), float), jax.ShapeDtypeStruct((2,), float, weak_type=True),
    ]  # fmt: skip
    assert len({fingerprint(v) for v in values}) == len(values)


@pytest.mark.parametrize("value", [lambda: 0, object(), Colour.RED, np.array([None]), (1, object())])
def test_values_that_cannot_be_distinguished_are_refused(value):
    with pytest.raises(NotPlainError):
        fingerprint(value)


def test_nothing_in_the_packages_unpickles_or_evaluates():
    banned = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
    for package in (pftwin, fitting):
        for path in Path(package.__path__[0]).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [a.name for a in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                parts = {part for name in names for part in name.split(".")}
                assert not parts & (banned | {"serialize_executable"}), path
                if isinstance(node, ast.Call):
                    assert getattr(node.func, "id", "") not in ("eval", "exec"), path
                    assert not any(k.arg == "allow_pickle" and ast.unparse(k.value) != "False" for k in node.keywords)


class TestWhoseFolder:
    @pytest.fixture(autouse=True)
    def _as_before(self):
        before = folder.chosen()
        yield
        folder.use_cache_folder(before)

    def test_it_is_made_for_its_owner_alone(self, tmp_path):
        assert folder.use_cache_folder(tmp_path / "kept")
        folder.write("values", "a", b"content")
        assert [p.stat().st_mode & 0o777 for p in (tmp_path / "kept", tmp_path / "kept" / "values")] == [0o700] * 2

    @pytest.mark.parametrize("which", ["", "programs"])
    @pytest.mark.parametrize("mode", [0o777, 0o770, 0o722])
    def test_one_that_others_can_write_to_is_not_used(self, tmp_path, which, mode):
        (tmp_path / "kept" / "programs").mkdir(parents=True)
        (tmp_path / "kept" / which).chmod(mode)
        with pytest.warns(PftwinWarning, match=r"others can write to .*nothing is cached.*chmod"):
            assert not folder.use_cache_folder(tmp_path / "kept")
        assert folder.chosen() is None

    def test_one_of_another_user_is_not_used(self, tmp_path, monkeypatch):
        owner = tmp_path.stat().st_uid
        monkeypatch.setattr("os.getuid", lambda: owner + 1)
        with pytest.warns(PftwinWarning, match="belongs to another user"):
            assert not folder.use_cache_folder(tmp_path)
        assert folder.chosen() is None
