"""Rules of thumb of the field, and whether a rig keeps them."""

from __future__ import annotations

import math

from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.design.optimise.parts import Rule

__all__ = ["rules_of"]

_GUIDE = "International Digital Image Correlation Society, A Good Practices Guide for Digital Image Correlation, 2018"
_VIC = "Correlated Solutions, manual of VIC-3D 8: speckles that are 3 to 5 pixels in size"
_PRACTICE = "common practice in image correlation"
_CUT = 2.0
"""The window is cut at so many standard deviations."""


def rules_of(facts: Facts) -> tuple[Rule, ...]:
    """Return the rules at a rig.

    Parameters
    ----------
    facts
        The rig.
    """
    causes, camera = facts.causes, facts.scene.camera
    # Dots of a diameter D have most of their gradient in waves of about 2 D.
    speckle = causes.wavelength_px / 2
    angle = math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))
    brightest = causes.brightest_level
    features = 2 * _CUT * causes.window_sigma_px / causes.wavelength_px
    overlap = 1 - camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width
    blur = causes.blur_px
    return (
        Rule(
            "size of speckles",
            f"{_VIC}; likewise {_GUIDE}",
            "3 to 5 px, lest they are folded by the pixels",
            f"{speckle:.1f} px (half the mean wavelength)",
            3 <= speckle <= 5,
        ),
        Rule(
            "stereo angle",
            _GUIDE,
            "15 to 35° between two cameras; with many positions in small steps, matching needs no such compromise",
            f"{angle:.1f}° between the outermost positions",
            15 <= angle <= 35,
        ),
        Rule(
            "motion blur",
            f"{_PRACTICE}: what moves by 0.1 px loses 0.1 % of the contrast of waves of 4 px",
            "less than 0.1 px while an image is exposed",
            f"{blur:.2g} px",
            blur < 0.1,
        ),
        Rule(
            "saturation",
            _PRACTICE,
            "no grey value at full scale",
            f"brightest grey values at {100 * brightest:.0f} % of full scale",
            brightest < 1,
        ),
        Rule(
            "features in a window",
            f"{_GUIDE}: a subset holds three features or more along each side",
            "three speckles or more along a side",
            f"{2 * features:.1f} along {2 * _CUT * causes.window_sigma_px:.0f} px",
            2 * features >= 3,
        ),
        Rule(
            "overlap of the outermost views",
            _PRACTICE,
            "more than half of the image's width",
            f"{100 * max(overlap, 0.0):.0f} %",
            overlap > 0.5,
        ),
    )
