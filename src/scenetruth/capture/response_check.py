"""Findings of the check of a capture, and that of the response of its camera: linear, or encoded for a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.radiometry import GammaFit, fit_gamma, measure_linearity
from scenetruth.errors import ArgumentError
from scenetruth.number_format import format_two_digits, format_with_std

__all__ = ["CaptureFinding", "Severity", "check_response"]

_GAMMA_OF_EXPOSURES = 0.05
_SIGMAS = 4.0
_SATURATED = 1e-3  # share of the pixels of an image
_BLACK_DN = 2.0

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class CaptureFinding:
    """A single result of a check.

    ``mistake``: Name of the mistake: ``files``, ``missing_image``, ``turned``, ``saturated``, ``gamma``, ``dark``,
    ``flat``, ``exposure``, ``blurred``, ``bit_depth``, ``board``, ``units``.
    ``severity``: ``error`` where results would be wrong, ``warning`` where they are impaired, ``note`` otherwise.
    ``message``: Path, what was measured, and what to do.

    See Also
    --------
    check_capture : Returns it.

    Examples
    --------
    >>> str(CaptureFinding("gamma", "error", "the response has an exponent of 0.45"))
    'error: gamma: the response has an exponent of 0.45'
    """

    mistake: str
    severity: Severity
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.mistake}: {self.message}"


def check_response(
    folder: CaptureFolder, edges: GammaFit | None, *, usable: bool
) -> tuple[GammaFit | None, list[CaptureFinding]]:
    """Return the exponent of the response, and what it shows.

    ``edges``: Exponent from the edges of the board.
    ``usable``: Whether the noise of the frames can be used: they are not saturated, and the dark frames belong to them.
    """
    if folder.images.pixels.encoding != "linear":
        message = f"images are made linear by camera.encoding {folder.images.pixels.encoding}, which is not tested"
        return None, [CaptureFinding("gamma", "note", message)]
    found = _exposures(folder)
    fits = _fits_of_gamma(folder) if usable and not any(each.mistake == "dark" for each in found) else []
    decisive = min((fit for fit in fits if fit.linear is not None), key=lambda fit: fit.std, default=None)
    proportional = any(each.severity == "note" for each in found)
    encoded = edges is not None and edges.exponent < _ENCODED and edges.exponent + _SIGMAS * edges.std < _LINEAR_EDGES
    agreeing = [*fits, edges] if edges is not None and encoded else fits
    if decisive is not None and proportional and abs(decisive.exponent - _OF_EVEN_NOISE) < _EVEN_NOISE:
        message = (
            f"the noise does not depend on the light (exponent {_spell(decisive)} of the "
            "response if it were photon noise), and flat fields are proportional to it: noise that is added"
        )
        found.append(CaptureFinding("gamma", "note", message))
    elif decisive is not None and decisive.linear is False:
        message = (
            f"the noise of frames at rest shows an exponent of {_spell(decisive)} of the "
            "response, which is 1 for linear values"
        )
        if proportional or not (encoded or _explains_dark(folder, decisive)):
            message += "; flat fields or dark frames contradict it: did the scene or the camera move in these frames?"
            found.append(CaptureFinding("gamma", "warning", message))
        else:
            found.append(CaptureFinding("gamma", "error", f"{message}: {_GAMMA_REMEDY}"))
    elif decisive is None and (response := _response_of_dark(folder, agreeing)):
        source = "edges of the board" if encoded else "noise of frames at rest"
        message = f"{source} and mean of the dark frames agree on {response}: {_GAMMA_REMEDY}"
        found.append(CaptureFinding("gamma", "error", message))
    elif encoded and edges is not None and decisive is None and not proportional:
        message = (
            f"the edges of the board have an exponent of {_spell(edges)} of the response, which "
            f"is 1 for linear values, where blur is symmetric: {_GAMMA_REMEDY}"
        )
        found.append(CaptureFinding("gamma", "warning", message))
    elif decisive is None and not _flat_exposures(folder):
        message = (
            "the linearity is not tested: add static frames with dark frames (files.static, three at least), or flat "
            "fields of two exposure times (files.flat with {level})"
        )
        found.append(CaptureFinding("gamma", "note", message))
    return decisive or next(iter(fits), None), found


def _fits_of_gamma(folder: CaptureFolder) -> list[GammaFit]:
    """Return the exponents that the noise of each set of frames shows."""
    dark = folder.dark if folder.dark is not None and folder.dark.count > 1 else None
    moments = [
        frames.moments(level)
        for name in ("static", "flat")
        if (frames := folder.sets.get(name))
        for level in frames.levels
    ]
    return [
        fit_gamma(each, full_scale=folder.images.pixels.full_scale, dark=dark)
        for each in moments
        if each.count > 2 and each.mean.ndim == 2
    ]


def _response_of_dark(folder: CaptureFolder, fits: Sequence[GammaFit]) -> str:
    """Return the response that turns the black level into the dark frames, if a measured exponent agrees; else empty.

    The noise alone may leave two exponents, of which one agrees with the dark frames.
    """
    full, black = folder.images.pixels.full_scale, folder.capture.camera.black_level_dn
    if folder.dark is None or black <= 0 or folder.dark.mean.mean() <= 0:
        return ""
    level = float(np.log(folder.dark.mean.mean() / full) / np.log(black / full))
    if level >= 1 - _LEAST_ENCODING:
        return ""
    if _is_srgb_of_black(folder) and any(_SRGB[0] < fit.exponent < _SRGB[1] for fit in fits):
        return "the response of sRGB, which is not linear"
    if any(abs(fit.exponent - level) < max(_SAME_EXPONENT, _SAME_SHARE * level) for fit in fits):
        return f"an exponent of {level:.2f} of the response, which is 1 for linear values"
    return ""


def _is_srgb_of_black(folder: CaptureFolder) -> bool:
    """Return whether sRGB turns the stated black level into the mean of the dark frames."""
    full, black = folder.images.pixels.full_scale, folder.capture.camera.black_level_dn
    if folder.dark is None or black <= 0:
        return False
    share = black / full
    encoded = full * (12.92 * share if share <= 0.0031308 else 1.055 * share ** (1 / 2.4) - 0.055)
    return bool(abs(encoded - folder.dark.mean.mean()) < max(_BLACK_DN, 0.05 * encoded))


_SAME_EXPONENT, _SAME_SHARE, _LEAST_ENCODING = 0.05, 0.2, 0.2
_SRGB = (0.33, 0.67)  # exponents by which sRGB is described, from dark to bright
_ENCODED, _LINEAR_EDGES = 0.72, 0.78


def _spell(fit: GammaFit) -> str:
    return format_with_std(fit.exponent, fit.std)


def _explains_dark(folder: CaptureFolder, fit: GammaFit) -> bool:
    """Return whether an exponent turns the stated black level into the mean of the dark frames."""
    full, black = folder.images.pixels.full_scale, folder.capture.camera.black_level_dn
    if folder.dark is None or black == 0 or (_SRGB[0] < fit.exponent < _SRGB[1] and _is_srgb_of_black(folder)):
        return True
    expected, level = full * (black / full) ** fit.exponent, float(folder.dark.mean.mean())
    return bool(abs(expected - level) < max(_BLACK_DN, _BLACK_SHARE * level))


_BLACK_SHARE = 0.3
_OF_EVEN_NOISE, _EVEN_NOISE = 0.5, 0.03  # the exponent that makes photon noise even, and its tolerance
_GAMMA_REMEDY = "switch off gamma in the camera (gamma 1), or state camera.encoding"


def _flat_exposures(folder: CaptureFolder) -> Mapping[int, float]:
    """Return the exposure times of unsaturated flat fields, if there are two different times at least."""
    flat = folder.sets.get("flat")
    if flat is None:
        return {}
    full = folder.images.pixels.full_scale
    times = {level: flat.exposure_time_s(level) for level in flat.levels}
    usable = {
        level: time
        for level, time in times.items()
        if time is not None and float(np.mean(flat.moments(level).highest >= full)) < _SATURATED
    }
    return usable if len(set(usable.values())) > 1 else {}


def _exposures(folder: CaptureFolder) -> list[CaptureFinding]:
    """Return what flat fields of several exposure times show; a note if they are proportional."""
    times = _flat_exposures(folder)
    if not times:
        return []
    # A wrong dark frame also makes flat fields disproportional; the stated black level is independent of it.
    flat, stated = folder.sets["flat"], folder.capture.camera.black_level_dn
    means = [folder.light_of_flat(level).mean() for level in times]
    again = [flat.moments(level).mean.mean() - stated for level in times]
    linearities = []
    for values in (means, again):
        try:
            linearities.append(measure_linearity(list(times.values()), list(map(float, values)), std_dn=0.5))
        except ArgumentError as error:
            return [CaptureFinding("flat", "error", f"files.flat: {error.problems[0].message}")]
    linearity = linearities[0]
    if all(abs(one.exponent - 1) > max(_GAMMA_OF_EXPOSURES, _SIGMAS * one.exponent_std) for one in linearities):
        message = (
            f"flat fields are not proportional to the exposure time but to its power of {linearity.exponent:.3f}: "
            f"{_GAMMA_REMEDY}"
        )
        return [CaptureFinding("gamma", "error", message)]
    if abs(linearity.exponent - 1) > _GAMMA_OF_EXPOSURES:
        message = (
            f"flat fields are proportional to the exposure time less the stated black level of {stated:g} DN, but not "
            f"less the dark frames (power of {linearity.exponent:.3f})"
        )
        return [CaptureFinding("dark", "error", f"files.dark: {message}; take new dark frames")]
    message = f"flat fields are proportional to the exposure time within {format_two_digits(100 * linearity.error)} %"
    return [CaptureFinding("gamma", "note", message)]
