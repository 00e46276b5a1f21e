"""What is usual of each clinical index, in words with the source: for readers, nothing is computed from it.

All of it is of natural knees on X-rays, CT or MR images. An implant's groove or a rig need not be like them.
"""

from __future__ import annotations

USUAL = {
    "tt_tg": (
        "above some 15 to 20 mm abnormal in extension; healthy knees 15 +- 3 mm there, 10 +- 3 mm at 15 deg and "
        "8 +- 3 mm at 30 deg (Dietrich et al. 2014)"
    ),
    "q_angle": "some 13 deg in men and 18 deg in women, in extension",
    "caton_deschamps": (
        "0.96 +- 0.13 in men, 0.99 +- 0.13 in women, from 10 to 80 deg of knee flexion; 1.2 and more patella alta, "
        "0.8 and less patella infera (Caton and Deschamps)"
    ),
    "sulcus_angle": "135 +- 10 deg; above 145 to 150 deg dysplastic",
    "lateral_trochlear_inclination": "below 11 deg dysplastic (Carrillon et al. 2000)",
}
