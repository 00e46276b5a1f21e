"""What acts on the patella: tendons, contacts, gravity, damping and others, and the base for an effect of your own.

scene.with_effect(pftwin.effects.LinearDamping(...)); class Brace(pftwin.effects.Effect): ...
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pftwin.base.lazy_names import lazy_names

if TYPE_CHECKING:  # `as` marks names that are exported
    from pftwin.base.quantities import quantity as quantity
    from pftwin.base.spatial import Quaternion as Quaternion
    from pftwin.base.spatial import Scalar as Scalar
    from pftwin.base.spatial import Vec3 as Vec3
    from pftwin.geometry.wrapping.cylinder import Cylinder as Cylinder
    from pftwin.geometry.wrapping.ellipsoid import Ellipsoid as Ellipsoid
    from pftwin.geometry.wrapping.sphere import Sphere as Sphere
    from pftwin.model.effects.base import Effect as Effect
    from pftwin.model.effects.base import Instant as Instant
    from pftwin.model.effects.base import Load as Load
    from pftwin.model.effects.base import Observable as Observable
    from pftwin.model.effects.base import Patella as Patella
    from pftwin.model.effects.base import StiffTerm as StiffTerm
    from pftwin.model.effects.contact_law import Flores as Flores
    from pftwin.model.effects.contact_law import Hertz as Hertz
    from pftwin.model.effects.contact_law import HuntCrossley as HuntCrossley
    from pftwin.model.effects.damping import LinearDamping as LinearDamping
    from pftwin.model.effects.elastic_foundation import ElasticFoundation as ElasticFoundation
    from pftwin.model.effects.foundation_law import LinearFoundation as LinearFoundation
    from pftwin.model.effects.foundation_law import LogarithmicFoundation as LogarithmicFoundation
    from pftwin.model.effects.foundation_law import checked_layer as checked_layer
    from pftwin.model.effects.friction import Friction as Friction
    from pftwin.model.effects.gravity import Gravity as Gravity
    from pftwin.model.effects.line_elements import ElasticLine as ElasticLine
    from pftwin.model.effects.line_elements import LineElement as LineElement
    from pftwin.model.effects.marker import Marker as Marker
    from pftwin.model.effects.mesh_contact import MeshContact as MeshContact
    from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact as MeshSphereContact
    from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact as MeshVolumeContact
    from pftwin.model.effects.sphere_contact import SphereContact as SphereContact
    from pftwin.model.effects.tendon import StrandGroup as StrandGroup
    from pftwin.model.effects.tendon import Tendon as Tendon
    from pftwin.model.effects.tendon import ToeTendon as ToeTendon
    from pftwin.model.effects.tension import PrescribedTension as PrescribedTension
    from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon as ViscoelasticTendon

_HERE = "pftwin.model.effects"
_HOMES = {
    f"{_HERE}.base": ("Effect", "Instant", "Load", "Observable", "Patella", "StiffTerm"),
    f"{_HERE}.contact_law": ("Flores", "Hertz", "HuntCrossley"),
    f"{_HERE}.damping": ("LinearDamping",),
    f"{_HERE}.elastic_foundation": ("ElasticFoundation",),
    f"{_HERE}.foundation_law": ("LinearFoundation", "LogarithmicFoundation", "checked_layer"),
    f"{_HERE}.friction": ("Friction",),
    f"{_HERE}.gravity": ("Gravity",),
    f"{_HERE}.line_elements": ("ElasticLine", "LineElement"),
    f"{_HERE}.marker": ("Marker",),
    f"{_HERE}.mesh_contact": ("MeshContact",),
    f"{_HERE}.mesh_sphere_contact": ("MeshSphereContact",),
    f"{_HERE}.mesh_volume_contact": ("MeshVolumeContact",),
    f"{_HERE}.sphere_contact": ("SphereContact",),
    f"{_HERE}.tendon": ("StrandGroup", "Tendon", "ToeTendon"),
    f"{_HERE}.tension": ("PrescribedTension",),
    f"{_HERE}.viscoelastic_tendon": ("ViscoelasticTendon",),
    "pftwin.base.quantities": ("quantity",),
    "pftwin.base.spatial": ("Quaternion", "Scalar", "Vec3"),
    "pftwin.geometry.wrapping.cylinder": ("Cylinder",),
    "pftwin.geometry.wrapping.ellipsoid": ("Ellipsoid",),
    "pftwin.geometry.wrapping.sphere": ("Sphere",),
}

if not TYPE_CHECKING:  # so that type checkers report names that do not exist
    __getattr__, __dir__, __all__ = lazy_names("pftwin.effects", _HOMES)
