"""What patterns are worth, in plain words with numbers."""

from __future__ import annotations

from collections.abc import Sequence

from scenetruth.design.pattern.make import Pattern
from scenetruth.design.pattern.rig import Rig
from scenetruth.design.pattern.worth import Worth, figures_by_size

__all__ = ["SIZES_PX", "pattern_words", "size_rows", "worth_words"]

SIZES_PX = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
"""Diameters of dots that are compared."""

_ALIASED = 0.05
_BLEACHED, _DARK = 0.9, 0.1
_OWN_PX = 4.0


def worth_words(worths: Sequence[Worth]) -> list[str]:
    """Return what the first pattern allows, and how the others compare to it.

    Parameters
    ----------
    worths
        The patterns.
    """
    found = []
    for number, worth in enumerate(worths):
        told = f"{worth.label}: gradients of {100 * worth.gradient:.3g} % of full scale per px"
        told += f", noise {100 * worth.noise_std:.2g} %, speckles of {worth.size_px:.2g} px"
        if worth.disparity_px is not None:
            told += f"; disparity to {worth.disparity_px:.2g} px per step at best"
        if worth.depth_mm is not None:
            told += f", depth to {worth.depth_mm:.2g} mm"
        if worth.flow_px is not None:
            told += f", flow to {worth.flow_px:.2g} px per frame"
        found.append(f"{told} (window σ {worth.window_sigma_px:g} px)")
        found += _warnings(worth)
        if number and worths[0].gradient > 0 and worth.gradient > 0:
            ratio = _noise_over_gradient(worth) / _noise_over_gradient(worths[0])
            found.append(f"{worth.label}: {ratio:.2g} times the noise of depth and motion that {worths[0].label} gives")
    return found


def _noise_over_gradient(worth: Worth) -> float:
    # A sensor without noise leaves the gradients.
    return (worth.noise_std or 1.0) / worth.gradient


def _warnings(worth: Worth) -> list[str]:
    found = []
    if worth.aliased_share > _ALIASED:
        share = f"{100 * worth.aliased_share:.0f} %"
        found.append(f"{worth.label}: {share} of its variance is too fine for the pixels (aliasing): make it coarser")
    if worth.mean > _BLEACHED:
        found.append(f"{worth.label}: {100 * worth.mean:.0f} % of full scale in the mean: expose for a shorter time")
    if worth.mean < _DARK:
        found.append(f"{worth.label}: {100 * worth.mean:.0f} % of full scale in the mean: give more light")
    return found


def pattern_words(pattern: Pattern) -> list[str]:
    """Return what a pattern is, and how large its dots are at the nearest and the farthest depth.

    Parameters
    ----------
    pattern
        The pattern.
    """
    rig, width = pattern.rig, pattern.size_mm
    found = [f"{pattern.model.kind} of {width[0]:g} x {width[1]:g} mm: {pattern.told}"]
    if rig.depth_range_mm is not None and rig.depth_range_mm[0] < rig.depth_range_mm[1]:
        near, far = (pattern.model.finest_mm * rig.focal_length_px / depth for depth in rig.depth_range_mm)
        depths = " and ".join(f"{depth:.0f} mm" for depth in rig.depth_range_mm)
        found.append(f"finest {near:.2f} and {far:.2f} px at the scene's nearest and farthest depths, {depths}")
    seen = rig.field_mm
    if seen is not None and (seen[0] > width[0] or seen[1] > width[1]):
        found.append(f"smaller than the field of view, {seen[0]:.0f} x {seen[1]:.0f} mm")
    return found


def size_rows(rig: Rig, coverage: float = 0.5) -> list[tuple[float, float, float, float]]:
    """Return what dots of several sizes are worth to a rig, from theory: dots that lie anywhere.

    Parameters
    ----------
    rig
        The rig.
    coverage
        Share of the sheet that they cover.

    Returns
    -------
    list of tuple
        Diameter in px and in mm, noise of depth and motion relative to dots of 4 px, and the share of the variance that
        is too fine for the pixels.
    """
    seen = figures_by_size(rig, SIZES_PX, coverage)
    own = seen[_OWN_PX].gradient_x
    return [(size, size * rig.mm_per_px, own / each.gradient_x, each.aliased_share) for size, each in seen.items()]
