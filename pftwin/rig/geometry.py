"""Parameters of the virtual rig: springs, supports, patella, button and marker clusters.

Published (Michaud et al. 2024, section 2.1): both springs' stiffness, free lengths (L1a, L1b = L1a + 19.6 mm, L2) and
damping (0.01 s times the stiffness), the four combinations of supports, eight markers, 100 Hz. All other values are
choices, because the paper does not give them. Cases 1 and 2 differ only in the tibial support, as in the paper.

Metres, kilograms, seconds. Femur frame: x proximal, y lateral (right knee), z anterior, origin on the trochlear axis.
Tibia frame: equal to the femur frame in full extension. Patella frame: parallel axes, origin at the button's centre.
"""

from __future__ import annotations

from typing import NamedTuple

RATE = 100.0  # [Hz]
DURATION = 7.2  # [s]

QUADRICEPS_STIFFNESS = 156.0  # K1 [N/m], published
QUADRICEPS_LENGTH = 0.1432  # L1a [m], published
QUADRICEPS_LENGTH_LONG = 0.1628  # L1b [m], published
PATELLAR_TENDON_STIFFNESS = 629.0  # K2 [N/m], published
PATELLAR_TENDON_LENGTH = 0.0714  # L2 [m], published
DAMPING_TIME = 0.01  # c = 0.01 s * K, published

FEMUR_SUPPORT = (0.220, 0.045)  # x and z of the quadriceps' support on the femur [m]
TIBIA_SUPPORT = (-0.075, 0.045)  # x and z of the patellar tendon's support on the tibia [m]
MEDIAL_LATERAL = {"FM": -0.005, "FL": 0.025, "TM": 0.003, "TL": 0.019}  # y of each support [m]

INSERTION = (0.020, 0.0, -0.009)  # of the quadriceps on the patella [m]; the tendon's has the opposite x
CENTER_OF_MASS = (0.0, 0.0, -0.012)  # [m]
MASS = 0.120  # [kg]
INERTIA = (4.0e-5, 3.5e-5, 6.0e-5)  # principal moments [kg m^2]
BUTTON_RADIUS = 0.025  # [m]

CONTACT_STIFFNESS = 2.0e8  # [N/m^1.5]
RESTITUTION = 0.5
DRAG = (3.0, 2.0e-3)  # viscous drag of the lubricated joint [N s/m, N m s/rad]

# Of the plant that the recordings are made of, where it differs from the twin.
STIFFENING = 0.05  # relative increase of a spring's stiffness at a stretch of a quarter of its length
MISPLACED = 0.6e-3  # standard deviation of the error in each coordinate of an attachment: about 1 mm in total [m]

GRAVITY = (0.0, 0.0, -9.81)  # in the world, whose z points up; the leg lies supine [m/s^2]
HIP = (0.40, 0.0, 0.0)  # centre of the hip in the femur frame and, as a fixed point, in the world [m]

# Markers in the frame of their segment [m]. The femur has two and the hip's centre, a known fixed point.
FEMUR_MARKERS = {"FEM1": (0.150, 0.040, 0.075), "FEM2": (0.165, -0.045, 0.070)}
TIBIA_MARKERS = {"TIB1": (-0.110, 0.035, 0.060), "TIB2": (-0.190, -0.035, 0.065), "TIB3": (-0.260, 0.030, 0.055)}
PATELLA_MARKERS = {"PAT1": (0.032, 0.004, 0.024), "PAT2": (-0.016, 0.033, 0.022), "PAT3": (-0.018, -0.031, 0.026)}


class RigCase(NamedTuple):
    """One of the rig's four configurations."""

    femur_support: str  # "FM" or "FL"
    tibia_support: str  # "TM" or "TL"
    quadriceps_length: float  # free length of the quadriceps spring [m]


CASES = {
    1: RigCase("FL", "TM", QUADRICEPS_LENGTH),
    2: RigCase("FL", "TL", QUADRICEPS_LENGTH),
    3: RigCase("FL", "TL", QUADRICEPS_LENGTH_LONG),
    4: RigCase("FM", "TL", QUADRICEPS_LENGTH),
}
