"""Reflectance and transmittance of green leaves by wavelength, as materials of scenes with bands.

The values are those of the model PROSPECT-D (Féret et al. 2017) at the parameters of `BladeSpectrum`, without
anthocyanins and brown pigments. They were computed once by the package ``prosail`` 2.0.5, as
``run_prospect(N, Cab, Car, 0, Cw, Cm, prospect_version="D")`` at single wavelengths, and rounded to 1e-4. The
parameters are typical of young, mature and dark green leaves of broad-leaved plants, and not of a species.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from scenetruth.errors import ArgumentError, Problem

__all__ = ["LEAF_SPECTRA", "LEAF_WAVELENGTHS_NM", "BladeSpectrum", "leaf_material"]

LEAF_WAVELENGTHS_NM = (450, 475, 500, 525, 550, 575, 600, 625, 650, 660, 675, 700, 725, 750, 800, 850)
"""Wavelengths of the spectra in nm."""

_NAMED_NM = {"blue": 450, "green": 550, "red": 660, "near_infrared": 850}
_INDEX = 1.4
_MOST_BANDS = 16


@dataclass(frozen=True)
class BladeSpectrum:
    """Spectrum of a leaf, and the parameters of PROSPECT-D by which it was computed.

    Attributes
    ----------
    layers
        N, structure parameter: number of layers.
    chlorophyll_ug_cm2, carotenoids_ug_cm2
        Cab and Car in µg/cm².
    water_cm
        Cw, equivalent water thickness in cm.
    dry_matter_g_cm2
        Cm, dry matter in g/cm².
    reflectance, transmittance
        Of light from one side into all directions, at `LEAF_WAVELENGTHS_NM`. The reflectance includes that of the
        surface.

    See Also
    --------
    leaf_material : Material with such a spectrum.

    Examples
    --------
    >>> spectrum = LEAF_SPECTRA["green_leaf"]
    >>> at = LEAF_WAVELENGTHS_NM.index(850)
    >>> round(1 - spectrum.reflectance[at] - spectrum.transmittance[at], 4)
    0.0491
    """

    layers: float
    chlorophyll_ug_cm2: float
    carotenoids_ug_cm2: float
    water_cm: float
    dry_matter_g_cm2: float
    reflectance: tuple[float, ...]
    transmittance: tuple[float, ...]


LEAF_SPECTRA: Mapping[str, BladeSpectrum] = MappingProxyType(
    {
        "young_leaf": BladeSpectrum(
            1.3, 20.0, 5.0, 0.01, 0.003,
            (0.0437, 0.0492, 0.0699, 0.1776, 0.2159, 0.1669, 0.1309, 0.1020,
             0.0730, 0.0606, 0.0441, 0.1924, 0.3717, 0.4208, 0.4315, 0.4312),
            (0.0155, 0.0337, 0.0771, 0.2262, 0.2752, 0.2217, 0.1796, 0.1419,
             0.0973, 0.0750, 0.0384, 0.2631, 0.4693, 0.5255, 0.5387, 0.5382),
        ),
        "green_leaf": BladeSpectrum(
            1.5, 40.0, 8.0, 0.0115, 0.005,
            (0.0413, 0.0421, 0.0507, 0.1340, 0.1538, 0.1075, 0.0798, 0.0609,
             0.0457, 0.0407, 0.0359, 0.1295, 0.3511, 0.4381, 0.4596, 0.4593),
            (0.0014, 0.0057, 0.0233, 0.1284, 0.1532, 0.1046, 0.0733, 0.0491,
             0.0255, 0.0161, 0.0048, 0.1375, 0.3766, 0.4686, 0.4921, 0.4916),
        ),
        "dark_leaf": BladeSpectrum(
            1.7, 65.0, 13.0, 0.014, 0.008,
            (0.0410, 0.0407, 0.0432, 0.0976, 0.1137, 0.0766, 0.0571, 0.0456,
             0.0381, 0.0362, 0.0349, 0.0929, 0.3235, 0.4449, 0.4785, 0.4780),
            (0.0001, 0.0006, 0.0050, 0.0622, 0.0797, 0.0458, 0.0271, 0.0149,
             0.0055, 0.0027, 0.0004, 0.0674, 0.2929, 0.4127, 0.4467, 0.4461),
        ),
    }
)  # fmt: skip
"""Spectra by name."""


def leaf_material(
    name: str, bands: Mapping[str, int] | None = None, *, refractive_index: float = _INDEX
) -> dict[str, Any]:
    """Return the material of a leaf for the bands of a camera, as in a scene file.

    Light that the boundary reflects does not enter the leaf: at normal incidence, boundary and leaf together have the
    reflectance and transmittance of the spectrum. They are those of a texture of value 1; other textures multiply them.

    Parameters
    ----------
    name
        ``"young_leaf"``, ``"green_leaf"`` or ``"dark_leaf"``.
    bands
        Wavelength in nm, one of `LEAF_WAVELENGTHS_NM`, by the name of each band; default: ``blue`` 450, ``green`` 550,
        ``red`` 660, ``near_infrared`` 850. At most 16.
    refractive_index
        That of the boundary; 1 for a matt leaf.

    Returns
    -------
    dict[str, Any]
        Fields ``refractive_index``, ``reflectance`` and ``transmittance``, the latter two by band.

    Raises
    ------
    ArgumentError
        If the name, a wavelength, the number of bands or the refractive index is not valid.

    See Also
    --------
    BladeSpectrum : Spectra and their parameters.

    Notes
    -----
    J.-B. Féret, A. A. Gitelson, S. D. Noble and S. Jacquemoud, "PROSPECT-D: Towards modeling leaf optical properties
    through a complete lifecycle", Remote Sens. Environ. 193, 204 (2017), https://doi.org/10.1016/j.rse.2017.03.004.

    Examples
    --------
    >>> leaf_material("green_leaf", {"green": 550, "nir_850": 850})["transmittance"]
    {'green': 0.1576, 'nir_850': 0.5056}
    """
    wanted = dict(_NAMED_NM if bands is None else bands)
    problems = []
    if name not in LEAF_SPECTRA:
        problems.append(Problem("name", f"must be one of {', '.join(LEAF_SPECTRA)}", name))
    problems += [
        Problem(f"bands.{band}", f"must be one of {', '.join(map(str, LEAF_WAVELENGTHS_NM))} nm", wavelength)
        for band, wavelength in wanted.items()
        if wavelength not in LEAF_WAVELENGTHS_NM
    ]
    if not 1 <= len(wanted) <= _MOST_BANDS:
        problems.append(Problem("bands", f"must be 1 to {_MOST_BANDS}", len(wanted)))
    if not 1 <= refractive_index <= _INDEX:
        # Larger indices reflect more than the whole leaf at 675 nm.
        problems.append(Problem("refractive_index", f"must be from 1 to {_INDEX}", refractive_index))
    if problems:
        raise ArgumentError(problems)
    spectrum = LEAF_SPECTRA[name]
    entering = 1 - ((refractive_index - 1) / (refractive_index + 1)) ** 2
    at = {band: LEAF_WAVELENGTHS_NM.index(wavelength) for band, wavelength in wanted.items()}
    return {
        "refractive_index": refractive_index,
        "reflectance": {band: round(1 - (1 - spectrum.reflectance[place]) / entering, 4) for band, place in at.items()},
        "transmittance": {band: round(spectrum.transmittance[place] / entering, 4) for band, place in at.items()},
    }
