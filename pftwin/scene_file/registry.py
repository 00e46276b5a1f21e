"""Which tables of a scene file are effects. A new effect is one file with its table, and one line here."""

from __future__ import annotations

from pftwin.scene_file.contact_table import ContactSection
from pftwin.scene_file.effect_tables import EffectSection
from pftwin.scene_file.field_tables import DampingSection, GravitySection
from pftwin.scene_file.foundation_table import ElasticFoundationSection
from pftwin.scene_file.mesh_contact_table import MeshContactSection
from pftwin.scene_file.strands_table import StrandsSection
from pftwin.scene_file.tendon_table import TendonSection
from pftwin.scene_file.tension_table import PrescribedTensionSection
from pftwin.scene_file.toe_tendon_table import ToeTendonSection
from pftwin.scene_file.viscoelastic_tendon_table import ViscoelasticTendonSection

EFFECTS: tuple[type[EffectSection], ...] = (
    GravitySection,
    TendonSection,
    ToeTendonSection,
    ViscoelasticTendonSection,
    StrandsSection,
    PrescribedTensionSection,
    ContactSection,
    MeshContactSection,
    ElasticFoundationSection,
    DampingSection,
)
