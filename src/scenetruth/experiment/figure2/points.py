"""One point of the paper's figure 2: its conditions and its result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Condition", "Quantity", "Result"]

Quantity = Literal["U_X", "U_Z", "V_X"]


@dataclass(frozen=True)
class Condition:
    """What one point of the figure is measured under.

    Parameters
    ----------
    quantity
        What is varied: U_X, U_Z, or the camera distance V_X, whose panel shows the error of Z.
    value
        Its value; everything else as in the paper (f = 10, Z_0 = 100, V_X = 1, no motion).
    wavelength_px
        λ of the pattern.
    noise_std
        σ_n of the images, for grey values in [-1, 1].
    """

    quantity: Quantity
    value: float
    wavelength_px: int
    noise_std: float


@dataclass(frozen=True)
class Result:
    """The errors under one condition, over phases of the pattern and seeds of the noise.

    Parameters
    ----------
    quantity, value, wavelength_px, noise_std
        The condition.
    runs
        How many measurements.
    full
        Number of them with a full estimate (``kind`` full). The statistics are over these; NaN if there is none.
    median_relative_error, rms_relative_error, max_relative_error
        Of abs(measured / true - 1).
    """

    quantity: Quantity
    value: float
    wavelength_px: int
    noise_std: float
    runs: int
    full: int
    median_relative_error: float
    rms_relative_error: float
    max_relative_error: float
