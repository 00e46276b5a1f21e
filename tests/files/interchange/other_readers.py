"""Readers that share nothing with the writers: of OpenSim's tables, and of binary glTF."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation


def read_table(path: Path) -> tuple[dict[str, str], list[str], np.ndarray]:
    """Header, labels and numbers of a .mot or .sto file, by the format's description alone."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=", 1) for line in lines[:end] if "=" in line)
    labels = lines[end + 1].split("\t")
    rows = np.array([[float(cell) for cell in line.split("\t")] for line in lines[end + 2 :]])
    return header, labels, rows


class Glb:
    """A .glb file: its JSON, and accessors as arrays."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        self.tree = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0"
        self.binary = data[28 + size : 28 + size + rest]
        assert self.tree["buffers"][0]["byteLength"] == len(self.binary)

    def rows(self, accessor: int) -> np.ndarray:
        a = self.tree["accessors"][accessor]
        view = self.tree["bufferViews"][a["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[a["componentType"]]
        start = view["byteOffset"] + a.get("byteOffset", 0)
        found = np.frombuffer(self.binary, kind, a["count"] * width, start).reshape(-1, width)
        assert start + found.nbytes <= view["byteOffset"] + view["byteLength"]
        np.testing.assert_array_equal(found.min(axis=0), np.asarray(a["min"], dtype=kind))
        np.testing.assert_array_equal(found.max(axis=0), np.asarray(a["max"], dtype=kind))
        return found

    def node(self, name: str) -> dict:
        (found,) = [n for n in self.tree["nodes"] if n.get("name") == name]
        return found

    def tracks(self, name: str) -> dict[str, np.ndarray]:
        """Values over time of what is animated of a node, and the times."""
        (animation,) = self.tree["animations"]
        number = self.tree["nodes"].index(self.node(name))
        found = {}
        for channel in animation["channels"]:
            if channel["target"]["node"] == number:
                sampler = animation["samplers"][channel["sampler"]]
                found[channel["target"]["path"]] = self.rows(sampler["output"])
                found["times"] = self.rows(sampler["input"])[:, 0]
        return found

    def matrix(self, name: str, frame: int) -> np.ndarray:
        """Of a node in its parent at a frame, by the specification: M = T R S."""
        tracks = self.tracks(name)
        out = np.eye(4)
        turn = Rotation.from_quat(tracks["rotation"][frame].astype(float)).as_matrix()
        out[:3, :3] = turn * tracks["scale"][frame] if "scale" in tracks else turn
        out[:3, 3] = tracks["translation"][frame]
        return out
