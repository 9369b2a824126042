"""What is predicted: standard deviations by region and quantity, beside what there is to be measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from scenetruth.design.predict.quantities import UNITS
from scenetruth.errors import Problem, SceneError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["Causes", "Figure", "Level", "Prediction"]

Level = Literal["envelope", "bound"]
_S_PER_H = 3600.0
_UNITS_INSIDE = {"%/h": "1/frame"}


@dataclass(frozen=True)
class Figure:
    """How precisely a quantity can be known in a region.

    Parameters
    ----------
    std
        Median over the region of its predicted standard deviation; infinite where the images do not tell it.
    unit
        Unit of ``std`` and ``signal``: as in data sets, growth per frame.
    signal
        Rms over the region of what there is to be measured, of motion and growth; None of others.
    value, signal_value, value_unit
        The same for people: growth in % per hour, all else as it is.
    known_share
        Share of the region where the images tell it.
    rms, percentile_95
        Root mean square over the region of the standard deviation, and the 95th percentile of the sizes of normal
        errors with such standard deviations; in ``value_unit``, infinite where the images do not tell it.
    """

    std: float
    unit: str
    signal: float | None
    value: float
    signal_value: float | None
    value_unit: str
    known_share: float
    rms: float = float("inf")
    percentile_95: float = float("inf")

    @property
    def signal_to_noise(self) -> float | None:
        """The signal over the standard deviation; None where there is no signal to speak of."""
        if self.signal is None:
            return None
        return self.signal / self.std if self.std > 0 else float("inf")


@dataclass(frozen=True)
class Causes:
    """What went into a prediction, medians over a region where nothing else is said.

    Parameters
    ----------
    noise_std
        Standard deviation of a grey value in one image, of full scale, rounding included.
    pattern_std
        The same of what pixels keep in all images.
    grey_level
        Mean grey value, of full scale.
    white_level
        Grey value of what is as bright as a texture can be, in the same light, of full scale.
    contrast
        Standard deviation of the texture in the images, of full scale.
    gradient_x, gradient_y
        Rms of its derivatives, of full scale per px.
    transfer
        Share of the texture's contrast that lens, pixels and motion leave.
    wavelength_px
        Rms mean wavelength of the texture in the images, in px: 2π contrast over the gradient's length.
    disparity_px, depth_mm
        Disparity in px per step, and depth.
    flow_px
        Length of the optical flow, px per frame.
    blur_px
        How far points move in the image while it is taken: of those that move, 95 % move less; 0 if none does.
    window_sigma_px, motion
        Of the method.
    positions, frames
        Number of cameras, and of frames that are estimated together.
    """

    noise_std: float
    pattern_std: float
    grey_level: float
    white_level: float
    contrast: float
    gradient_x: float
    gradient_y: float
    transfer: float
    wavelength_px: float
    disparity_px: float
    depth_mm: float
    flow_px: float
    blur_px: float
    window_sigma_px: float
    motion: str
    positions: int
    frames: int

    @property
    def brightest_level(self) -> float:
        """Brightest grey values, of full scale: three standard deviations above the mean, and no brighter than white.

        Over 1, images are saturated.
        """
        return min(self.grey_level + 3 * self.contrast, self.white_level)


@dataclass(frozen=True, eq=False)
class Prediction:
    """How precisely depth, motion, slopes and growth of a scene can be known from its images.

    Parameters
    ----------
    level
        ``"envelope"``: from geometry and the texture's spectrum; ``"bound"``: from an image without noise.
    method
        The method whose noise it is.
    regions
        ``"all"``, ``"interior"``, and ``"object_NAME"`` for every object that is seen: its interior, or all of it if it
        has none.
    frame_interval_s
        Time between two frames.
    figures
        Figures by region and quantity.
    by_region
        What went into it, by region.
    maps
        Maps of the standard deviations, ``depth_std`` and so on as in `cramer_rao`; None of an envelope.
    notes
        What is left out, in words.
    pattern_cost
        By what factor noise that stays with the pixels raises the standard deviations of quantities; those that are
        missing do not suffer. It is in the figures.
    """

    level: Level
    method: str
    regions: tuple[str, ...]
    frame_interval_s: float
    figures: Mapping[str, Mapping[str, Figure]]
    by_region: Mapping[str, Causes]
    maps: xr.Dataset | None = None
    notes: tuple[str, ...] = field(default=())
    pattern_cost: Mapping[str, float] = field(default_factory=dict)

    @property
    def causes(self) -> Causes:
        """What went into it: medians over all that is seen."""
        return self.by_region["all"]

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities that are predicted: keys of `scenetruth.scoring.QUANTITIES`."""
        return tuple(self.figures["all"])

    def figure(self, quantity: str, region: str = "all") -> Figure:
        """Return the figure of a quantity in a region.

        Parameters
        ----------
        quantity
            One of `quantities`.
        region
            One of `regions`.

        Raises
        ------
        SceneError
            If one of them is not predicted; says which are.
        """
        problems = []
        if region not in self.regions:
            problems.append(Problem("region", f"is not predicted; there are {', '.join(self.regions)}", region))
        if quantity not in self.quantities:
            message = f"is not predicted for this scene and method; there are {', '.join(self.quantities) or 'none'}"
            problems.append(Problem("quantity", message, quantity))
        if problems:
            raise SceneError(problems)
        return self.figures[region][quantity]

    def to_frame(self) -> pd.DataFrame:
        """Return a table, a figure each row: region, quantity, all of `Figure`, level, method."""
        import pandas as pd

        rows: list[dict[str, Any]] = [
            {"region": region, "quantity": quantity, **vars(figure), "level": self.level, "method": self.method}
            for region in self.regions
            for quantity, figure in self.figures[region].items()
        ]
        return pd.DataFrame(rows)


def figure_of(
    quantity: str,
    spread: tuple[float, float, float],
    signal: float | None,
    known_share: float,
    frame_interval_s: float,
) -> Figure:
    """Return a figure with what it is for people.

    Parameters
    ----------
    quantity
        Key of `UNITS`.
    spread
        Median and root mean square of the standard deviation, and the 95th percentile of errors.
    signal, known_share
        As of `Figure`.
    frame_interval_s
        Time between two frames.
    """
    unit = UNITS[quantity]
    factor = 100.0 * _S_PER_H / frame_interval_s if unit in _UNITS_INSIDE else 1.0
    told = None if signal is None else factor * signal
    std, rms, percentile = spread
    inside = _UNITS_INSIDE.get(unit, unit)
    return Figure(std, inside, signal, factor * std, told, unit, known_share, factor * rms, factor * percentile)
