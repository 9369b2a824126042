"""Figures of named sensors, each with where it was read: data only."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

from scenetruth.presets import Preset, preset

__all__ = ["CHOSEN", "PRESETS", "TYPICAL", "PresetName"]

PresetName = Literal["scientific_cmos", "industrial_cmos", "ccd_2002"]

TYPICAL = "typical value, not from the source"
"""Said of a figure that no source was found for: an order of magnitude, not a property of the product."""
CHOSEN = "chosen, not from the source"
"""Said of a figure that is a setting of the camera or of the light."""

_ZYLA_SHEET = (
    "Andor, Zyla OEM, product sheet, "
    "https://raw.githubusercontent.com/SciCrunch/RRID-Instruments/refs/heads/main/PDF/SCR_021136.pdf"
)
_ZYLA_MANUAL = (
    "Andor, Zyla sCMOS hardware manual 2.0 (2021), table 5, 16-bit (low noise and high well capacity), "
    "https://www.easymanua.ls/andor-technology/zyla-scmos-4-2-plus/manual?p=25"
)
_ALVIUM = (
    "Allied Vision, Alvium 1800 U-507 data sheet (EMVA 1288 release 3.1, monochrome, typical), as quoted in "
    "https://github.com/blitzcolo/Quantiloom-dev, src/libQuantiloom/postprocess/CameraPresets.cpp; the sheet itself "
    "was not read"
)
_SBIG = (
    "SBIG, operating manual of ST-7XE to ST-2000XM, table 4.3, row ST-2000XM, "
    "https://www.easymanua.ls/sbig/st-7xe/manual?p=50"
)
_OFFSET = "usual offset of scientific cameras, https://www.tucsen.com/ja/learning/demystifying-specifications-prnu"

# The photon rates let radiance 1 fill 80 % of what each sensor can say in the preset's exposure time.
PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "scientific_cmos": preset(
            "Andor Zyla 4.2 (sCMOS, 6.5 µm)",
            photon_rate_per_s=(2.873e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.82, _ZYLA_SHEET),
            full_well_e=(30000.0, _ZYLA_MANUAL),
            gain_dn_per_e=(2.222, f"1 / (0.45 e-/DN): {_ZYLA_MANUAL}"),
            bit_depth=(16, _ZYLA_MANUAL),
            black_level_dn=(100.0, _OFFSET),
            temporal_dark_noise_e=(0.9, _ZYLA_SHEET),
            dark_current_e_per_s=(0.1, TYPICAL),
            dsnu_e=(0.3, TYPICAL),
            prnu=(0.005, TYPICAL),
        ),
        "industrial_cmos": preset(
            "Allied Vision Alvium 1800 U-507 (Sony IMX264, 3.45 µm)",
            photon_rate_per_s=(1.3e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.64, f"at 529 nm: {_ALVIUM}"),
            full_well_e=(10400.0, f"saturation capacity: {_ALVIUM}"),
            gain_dn_per_e=(0.39, "follows: the saturation capacity fills the 12 bits above the black level"),
            bit_depth=(12, _ALVIUM),
            black_level_dn=(16.0, TYPICAL),
            temporal_dark_noise_e=(2.1, _ALVIUM),
            dark_current_e_per_s=(5.0, TYPICAL),
            dsnu_e=(0.5, TYPICAL),
            prnu=(0.005, TYPICAL),
        ),
        "ccd_2002": preset(
            "SBIG ST-2000XM (Kodak KAI-2000M, interline CCD, 7.4 µm), read with 12 bits",
            photon_rate_per_s=(7.2e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.5, TYPICAL),
            full_well_e=(45000.0, _SBIG),
            gain_dn_per_e=(0.09, "follows: the full well fills the 12 bits above the black level"),
            bit_depth=(12, f"{TYPICAL}: what measuring cameras of the time delivered"),
            black_level_dn=(32.0, TYPICAL),
            temporal_dark_noise_e=(15.0, _SBIG),
            dark_current_e_per_s=(50.0, f"{TYPICAL}: without cooling"),
            dsnu_e=(6.0, TYPICAL),
            prnu=(0.01, TYPICAL),
        ),
    }
)
