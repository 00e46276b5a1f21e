"""Geometry of the articulating surfaces: meshes, their trees, fitted patches, contact, wrapping and synthetic bones.

mesh = pftwin.surfaces.load_mesh("femur.stl", units="mm")
fit = pftwin.surfaces.fit_patch(pftwin.surfaces.trochlear_region(mesh, ...), degree=5)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pftwin.base.lazy_names import lazy_names

if TYPE_CHECKING:  # `as` marks names that are exported
    from pftwin.geometry.contact.depth_sides import pressed_surface as pressed_surface
    from pftwin.geometry.contact.depth_sides import pressing_surface as pressing_surface
    from pftwin.geometry.contact.distance_grid import distance_grid as distance_grid
    from pftwin.geometry.mesh.doctor import examine as examine
    from pftwin.geometry.mesh.doctor import examine_file as examine_file
    from pftwin.geometry.mesh.doctor import repaired as repaired
    from pftwin.geometry.mesh.mesh import SurfaceMesh as SurfaceMesh
    from pftwin.geometry.mesh.mesh import load_mesh as load_mesh
    from pftwin.geometry.mesh.mesh import save_mesh as save_mesh
    from pftwin.geometry.patch.charts import CylindricalChart as CylindricalChart
    from pftwin.geometry.patch.charts import PlaneChart as PlaneChart
    from pftwin.geometry.patch.fit import PatchFit as PatchFit
    from pftwin.geometry.patch.fit import fit_patch as fit_patch
    from pftwin.geometry.patch.polynomial import PolynomialPatch as PolynomialPatch
    from pftwin.geometry.patch.region import TrochlearRegion as TrochlearRegion
    from pftwin.geometry.patch.region import region_about as region_about
    from pftwin.geometry.patch.region import trochlear_region as trochlear_region
    from pftwin.geometry.patch.sphere import SphereFit as SphereFit
    from pftwin.geometry.patch.sphere import fit_sphere as fit_sphere
    from pftwin.geometry.patch.spline import SplinePatch as SplinePatch

_HERE = "pftwin.geometry"
_HOMES = {
    f"{_HERE}.contact.depth_sides": ("pressed_surface", "pressing_surface"),
    f"{_HERE}.contact.distance_grid": ("distance_grid",),
    f"{_HERE}.mesh.doctor": ("examine", "examine_file", "repaired"),
    f"{_HERE}.mesh.mesh": ("SurfaceMesh", "load_mesh", "save_mesh"),
    f"{_HERE}.patch.charts": ("CylindricalChart", "PlaneChart"),
    f"{_HERE}.patch.fit": ("PatchFit", "fit_patch"),
    f"{_HERE}.patch.polynomial": ("PolynomialPatch",),
    f"{_HERE}.patch.region": ("TrochlearRegion", "region_about", "trochlear_region"),
    f"{_HERE}.patch.sphere": ("SphereFit", "fit_sphere"),
    f"{_HERE}.patch.spline": ("SplinePatch",),
}

if not TYPE_CHECKING:  # so that type checkers report names that do not exist
    __getattr__, __dir__, __all__ = lazy_names("pftwin.surfaces", _HOMES)
