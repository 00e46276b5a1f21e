"""Contact models between the rig's button and femoral component, selected by name.

| name | geometry | indentation |
|---|---|---|
| P2, P4, P5, ... | the button's sphere on a polynomial patch | at the closest point of each facet |
| spline | the sphere on a bicubic spline | at the closest point of each facet |
| CM, FM | two meshes, coarse or fine, as in the paper | largest depth inside each contact contour |
| volume | the sphere on the fine mesh | from the overlap volume, which is smooth |
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Literal

import jax
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.program_cache import cached
from pftwin.geometry.mesh.mesh import SurfaceMesh, load_mesh
from pftwin.geometry.patch.emphasis import emphasis
from pftwin.geometry.patch.fit import SPLINE, PatchFit, fit_named, parse_name
from pftwin.geometry.patch.implant import RIG_PARTS, RIG_RIM, RIG_TOLERANCE, rig_implant, rig_region
from pftwin.model.effects.base import Effect
from pftwin.model.effects.contact_law import ContactLaw, Flores
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.rig import geometry as rig
from pftwin.rig.recording import IMPLANT_FILE, data_folder

MESHES = ("CM", "FM")
VOLUME = "volume"
ON_MESHES = (*MESHES, VOLUME)
_CENTER = (0.0, 0.0, 0.0)  # of the button's sphere, patella frame
_WIDE = 0.050  # half width of the meshes [m]: a dislocated button touches at 39 mm; the real component ends at 32 mm


def parse_contact(name: str | int) -> str:
    """Returns the canonical name of a contact; letter case is ignored.

    Raises:
        InputError: unknown contact.
    """
    for known in ON_MESHES:
        if isinstance(name, str) and name.strip().lower() == known.lower():
            return known
    try:
        return parse_name(name)
    except InputError as error:
        raise InputError(
            f"no contact {name!r}",
            where="contact",
            expected=f"P2, P4, P5 or another degree, {SPLINE}, CM, FM, {VOLUME}",
        ) from error


@lru_cache(maxsize=1)
def implant_mesh() -> SurfaceMesh:
    """Returns the fine mesh of the rig's femoral component from the laboratory's STL file."""
    return load_mesh(data_folder() / IMPLANT_FILE, units="m")


def contact_fit(contact: str = "P5", *, chart: Literal["plane", "cylinder"] = "plane") -> PatchFit:
    """Returns the named patch, a polynomial or "spline", fitted to the rig's femoral component.

    Raises:
        InputError: unknown patch or chart.
    """
    if chart not in ("plane", "cylinder"):
        raise InputError(f"no chart {chart!r}", where="chart", expected='"plane" or "cylinder"')
    return _fit(parse_name(contact), chart, canonicalize_dtype(float) == np.float64)


def contact_effect(name: str, *, chart: Literal["plane", "cylinder"] = "plane") -> Effect:
    """Returns the named contact with the rig's contact law (Flores et al. 2011).

    Raises:
        InputError: unknown contact or chart.
    """
    name = parse_contact(name)
    law = rig_law()
    if name in MESHES:
        return _of_meshes(name, law)
    if name == VOLUME:
        return _by_volume(law)
    surface = contact_fit(name, chart=chart).patch
    return SphereContact(surface, law, vector(_CENTER), number(rig.BUTTON_RADIUS))


def rig_law() -> Flores:
    """Returns the contact law of all the rig's contacts."""
    return Flores(number(rig.CONTACT_STIFFNESS), number(rig.RESTITUTION))


@lru_cache(maxsize=32)
def _fit(name: str, chart: Literal["plane", "cylinder"], float64: bool) -> PatchFit:
    return cached(_fitted, name, chart, float64, files=(data_folder() / IMPLANT_FILE,))


def _fitted(name: str, chart: Literal["plane", "cylinder"], float64: bool) -> PatchFit:
    mesh = implant_mesh()
    if name == SPLINE:
        return fit_named(mesh, name, chart=chart, region=rig_region(mesh, half_width=RIG_RIM), tolerance=RIG_TOLERANCE)
    region = rig_region(mesh)
    return fit_named(mesh, name, chart=chart, region=region, emphasis=emphasis(region, RIG_PARTS))


def _of_meshes(name: str, law: ContactLaw) -> Effect:
    from pftwin.geometry.contact.contact_mesh import contact_mesh
    from pftwin.geometry.mesh.icosphere import RESOLUTIONS, button_mesh
    from pftwin.model.effects.mesh_contact import MeshContact

    mesh, lateral = _femur(name)
    button = button_mesh(rig.BUTTON_RADIUS, RESOLUTIONS[name])
    femur, patella = contact_mesh(mesh, lateral), contact_mesh(button)
    return MeshContact(femur, patella, law, vector(_CENTER), surface=contact_fit(SPLINE).patch)


def _by_volume(law: ContactLaw) -> Effect:
    from pftwin.geometry.contact.patch_mesh import patch_mesh
    from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

    mesh, lateral = _femur("FM")
    made = patch_mesh(mesh, rig.BUTTON_RADIUS, lateral)
    radius, center = number(rig.BUTTON_RADIUS), vector(_CENTER)
    return MeshVolumeContact(made, law, center, radius, number(gap_radius()), surface=contact_fit(SPLINE).patch)


@lru_cache(maxsize=2)
def _femur(name: str) -> tuple[SurfaceMesh, NDArray[np.bool_]]:
    """The implant's mesh at the paper's resolution, and a mask of the triangles lateral of the groove."""
    vertices, faces, lateral = cached(_meshed, name, files=())
    return SurfaceMesh(vertices, faces, f"the rig's implant, {name}"), lateral


def _meshed(name: str) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    from pftwin.geometry.contact.patch_mesh import lateral_of_groove
    from pftwin.geometry.mesh.icosphere import RESOLUTIONS

    with jax.enable_x64(True):
        mesh = replace(rig_implant(), half_width=_WIDE).mesh(deviation=RESOLUTIONS[name])
        return mesh.vertices, mesh.faces, lateral_of_groove(mesh, rig_region(mesh))


def gap_radius() -> float:
    """Returns the effective radius beside the groove [m]; see `MeshVolumeContact`."""
    return cached(_measured_gap_radius, files=())


def _measured_gap_radius() -> float:
    from pftwin.geometry.contact.overlap import beside_groove, effective_radius
    from pftwin.geometry.contact.patch_mesh import patch_mesh

    with jax.enable_x64(True):
        mesh, lateral = _femur("FM")
        near = beside_groove(mesh, rig_region(mesh), 0.5 * rig.BUTTON_RADIUS)
        made = patch_mesh(mesh, rig.BUTTON_RADIUS, lateral)
        return float(effective_radius(mesh, made, rig.BUTTON_RADIUS, near))
