"""The same queries asked of collision libraries, where they are installed: python-fcl and coal."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from pftwin.base.spatial import Pose
from pftwin.geometry.mesh.mesh import SurfaceMesh

MOST_CONTACTS = 10_000


def peers(femur: SurfaceMesh, button: SurfaceMesh, deep: Pose, clear: Pose) -> list[tuple[str, float]]:
    """Names and median times of a query [s]: all contacts of two meshes, without any indentation."""
    out = []
    for module, ready in (("fcl", _fcl), ("coal", _coal)):
        try:
            library = importlib.import_module(module)
        except ImportError:
            continue
        query = ready(library, femur, button)
        for what, poses in (("touching", deep), ("clear", clear)):
            out.append((f"peer {module}, all contacts of the same meshes, {what}", _median(query, poses)))
    return out


def _median(query: Callable[[Any, Any], int], poses: Pose) -> float:
    rotation, place = poses.orientation.rotation(), np.asarray(poses.position.array())
    columns = [np.asarray(e.array()) for e in (rotation.ex, rotation.ey, rotation.ez)]
    turns = np.stack(columns, axis=-1)
    times = []
    for k in range(len(place)):
        began = time.perf_counter()
        query(np.ascontiguousarray(turns[k]), place[k])
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def _fcl(fcl: Any, femur: SurfaceMesh, button: SurfaceMesh) -> Callable[[Any, Any], int]:
    models = []
    for mesh in (femur, button):
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
        models.append(model)
    fixed = fcl.CollisionObject(models[0], fcl.Transform())
    moving = fcl.CollisionObject(models[1], fcl.Transform())
    request = fcl.CollisionRequest(num_max_contacts=MOST_CONTACTS, enable_contact=True)

    def query(turn: Any, place: Any) -> int:
        moving.setTransform(fcl.Transform(turn, place))
        result = fcl.CollisionResult()
        return fcl.collide(fixed, moving, request, result)

    return query


def _coal(coal: Any, femur: SurfaceMesh, button: SurfaceMesh) -> Callable[[Any, Any], int]:
    models = []
    for mesh in (femur, button):
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(mesh.faces), len(mesh.vertices))
        model.addVertices(mesh.vertices)
        model.addTriangles(mesh.faces)
        model.endModel()
        models.append(model)
    request = coal.CollisionRequest()
    request.num_max_contacts, request.enable_contact = MOST_CONTACTS, True

    def query(turn: Any, place: Any) -> int:
        result = coal.CollisionResult()
        return coal.collide(models[0], coal.Transform3s(), models[1], coal.Transform3s(turn, place), request, result)

    return query
