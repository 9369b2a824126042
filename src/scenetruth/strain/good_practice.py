"""The fields that a report of image correlation states by good practice, filled from a recording and its results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem, ScoreError
from scenetruth.results import Result
from scenetruth.schema import Intrinsics, read_intrinsics, read_scene
from scenetruth.scoring.alignment import count_blocks, iterate_blocks
from scenetruth.scoring.error_pairs import find_valid_pixels
from scenetruth.scoring.statistics import StreamingQuantiles
from scenetruth.strain.gauge import MEASURES, read_method_settings, read_subset_px

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["NOT_STATED", "GoodPracticeReport", "ReportField", "report_good_practice"]

NOT_STATED = "not stated in the recording"
_NOT_ESTIMATED = "not stated by the estimate"
_NO_STRAIN = "no strain computed"


@dataclass(frozen=True)
class ReportField:
    """One field of a report.

    Parameters
    ----------
    group
        ``imaging``, ``analysis`` or ``noise floor``.
    name
        Name of the field in the guide of the iDICs.
    value
        A number with three significant digits (all digits before the point) or a text; states if it is missing.
    unit
        Its unit; empty for texts.
    source
        From which data it follows.
    """

    group: str
    name: str
    value: str
    unit: str
    source: str

    @property
    def is_stated(self) -> bool:
        """Whether the field has a value."""
        return self.value not in (NOT_STATED, _NOT_ESTIMATED, _NO_STRAIN)


@dataclass(frozen=True, repr=False)
class GoodPracticeReport(Result):
    """The fields of a report of image correlation, after the guide of the iDICs (doi:10.32720/idics/gpg.ed1).

    Parameters
    ----------
    fields
        All fields in their order, also those without a value.

    See Also
    --------
    report_good_practice : Fill them from a recording and its results.

    Examples
    --------
    >>> lens = ReportField("imaging", "Lens", NOT_STATED, "", "recording")
    >>> report = GoodPracticeReport((lens, ReportField("imaging", "Image resolution", "640 x 480", "px", "recording")))
    >>> print(report.summary())
    1 of 2 fields are stated
    Lens: not stated
    """

    fields: tuple[ReportField, ...]

    def __repr__(self) -> str:
        return f"GoodPracticeReport({self.summary().splitlines()[0]})"

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row for each field, with its group, name, value, unit and source."""
        import pandas as pd

        rows = [(each.group, each.name, each.value, each.unit, each.source) for each in self.fields]
        return pd.DataFrame(rows, columns=["group", "field", "value", "unit", "source"])

    def to_csv(self) -> str:
        """Return the table as comma-separated values with a header."""
        return str(self.to_dataframe().to_csv(index=False, lineterminator="\n"))

    def summary(self) -> str:
        """Return how many fields have a value, and one line for each of the others."""
        missing = [each.name for each in self.fields if not each.is_stated]
        stated = f"{len(self.fields) - len(missing)} of {len(self.fields)} fields are stated"
        return "\n".join([stated, *(f"{name}: not stated" for name in missing)])


def report_good_practice(
    recording: xr.Dataset, estimate: xr.Dataset | None = None, strain: xr.Dataset | None = None
) -> GoodPracticeReport:
    """Return the fields that a report of image correlation states, from a recording, an estimate and its strain.

    Values are never assumed: a field that the data do not state says so. Lengths on the object refer to the median
    depth of the estimate or of the strain.

    Parameters
    ----------
    recording
        The recording; simulated recordings include their scene.
    estimate
        The estimate; default: the analysis is not stated.
    strain
        Strain of the estimate, see `compute_strain`.

    Returns
    -------
    GoodPracticeReport
        The fields on imaging, analysis and noise floors.

    Raises
    ------
    ScoreError
        If a data set has another type.

    See Also
    --------
    compute_strain : Strain with a stated gauge.

    Examples
    --------
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 2, 8, 10)), focal_length_px=500, baseline_mm=5)
    >>> estimate = st.make_estimate(recording=recording, depth=np.full((2, 8, 10), 250))
    >>> for each in st.report_good_practice(recording, estimate).fields[1:6]:
    ...     print(f"{each.name}: {each.value} {each.unit}".strip())
    Image resolution: 10 x 8 px
    Lens: not stated in the recording
    Focal length: 500 px
    Aperture: not stated in the recording
    Field of view: 5 x 4 mm
    """
    given = {"recording": recording, "estimate": estimate, "strain": strain}
    problems = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in given.items()
        if not isinstance(part, xr.Dataset) and (part is not None or name == "recording")
    ]
    for name, part in given.items():
        kind = part.attrs.get("scenetruth", name) if isinstance(part, xr.Dataset) else name
        if kind != name and (name, kind) != ("estimate", "truth"):
            problems.append(Problem(name, f"must be {_NAMES[name]}", kind))
    if problems:
        raise ScoreError(problems)
    depth = _median_depth(estimate, strain)
    found = [
        *_imaging(recording, depth),
        *_analysis(estimate, strain),
        *_noise_floors(estimate, strain, recording, depth),
    ]
    return GoodPracticeReport(tuple(found))


_NAMES = {"recording": "a recording", "estimate": "an estimate", "strain": "a strain data set"}


def _median_depth(estimate: xr.Dataset | None, strain: xr.Dataset | None) -> float:
    """Return the median depth of valid pixels in mm; NaN if there are none."""
    if estimate is not None and "depth" in estimate:
        return _median_of(estimate, _valid_depth)
    return _median(strain["point"].values[2]) if strain is not None and "point" in strain else math.nan


def _valid_depth(part: xr.Dataset) -> NDArray[np.float64]:
    values = part["depth"].values.astype(np.float64)
    return values[part["valid"].values.astype(bool)] if "valid" in part else values


def _velocity_std(component: int, part: xr.Dataset) -> NDArray[np.float64]:
    return np.where(find_valid_pixels(part, "velocity"), part["velocity_std"].values[component], np.nan)


def _depth_std(part: xr.Dataset) -> NDArray[np.float64]:
    return np.where(find_valid_pixels(part, "depth"), part["depth_std"].values, np.nan)


def _median_of(estimate: xr.Dataset, values: Callable[[xr.Dataset], NDArray[np.float64]]) -> float:
    """Return the median of the finite values of all frames, block by block; NaN if there are none."""
    found = StreamingQuantiles(single=count_blocks(estimate) == 1)
    for part in iterate_blocks(estimate):
        block = np.asarray(values(part), dtype=np.float64)
        found.add(block[np.isfinite(block)])
    return found.at([50])[0]


def _text(value: Any, missing: str = NOT_STATED) -> str:
    """Return a number with three significant digits, or all before the point; ``missing`` for None and NaN."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return missing
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if 1000 <= abs(value) < 1e9 else f"{value:.3g}"


def _imaging(recording: xr.Dataset, depth: float) -> Iterator[ReportField]:
    own, scene = read_intrinsics(recording), read_scene(recording) or {}
    width, height = recording.sizes["x"], recording.sizes["y"]

    def field(name: str, value: Any, unit: str = "", source: str = "recording") -> ReportField:
        text = _text(value)
        return ReportField("imaging", name, text, "" if text == NOT_STATED else unit, source)

    camera, optics = _part(scene, "camera"), _part(scene, "optics")
    shutter, sensor = _part(scene, "shutter"), _part(scene, "sensor")
    simulated = bool(scene)
    yield field("Camera", recording.attrs.get("camera") or ("simulated" if simulated else None))
    yield field("Image resolution", f"{width} x {height}", "px")
    yield field("Lens", recording.attrs.get("lens"))
    yield field("Focal length", _focal_length(own, camera), "mm" if _pitch(camera) else "px")
    yield field("Aperture", _part(optics, "psf").get("f_number") or _part(optics, "defocus").get("f_number"))
    scale = own.focal_length_px / depth
    view = f"{_text(width / scale)} x {_text(height / scale)}" if math.isfinite(scale) else None
    yield field("Field of view", view, "mm", "recording and depth")
    yield field("Image scale", scale, "px/mm", "recording and depth")
    yield field("Stereo angle", _stereo_angle(recording, depth), "°", "recording and depth")
    yield field("Camera positions", recording.sizes.get("s", 1))
    yield field("Stand-off distance", depth, "mm", "depth")
    yield field("Image acquisition rate", 1.0 / own.frame_interval_s, "Hz")
    exposure = shutter.get("exposure_time_s")
    yield field("Exposure time", float(exposure) if exposure else None, "s")
    yield field(
        "Grey levels", float(recording.attrs["full_scale"]) if "full_scale" in recording.attrs else None, "full scale"
    )
    yield field("Image noise", sensor.get("noise_std"), "of full scale", "scene")
    kinds = {
        str(_part(item, "texture").get("kind")) for item in scene.get("objects") or () if isinstance(item, Mapping)
    }
    yield field(
        "Patterning technique", "simulated texture: " + ", ".join(sorted(kinds)) if kinds else None, "", "scene"
    )
    yield field("Pattern feature size", _feature_size(scene), "mm", "scene")


def _part(plain: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = plain.get(name)
    return found if isinstance(found, Mapping) else {}


def _pitch(camera: Mapping[str, Any]) -> float | None:
    pitch = camera.get("pixel_pitch_um")
    return float(pitch) if isinstance(pitch, int | float) and pitch > 0 else None


def _focal_length(own: Intrinsics, camera: Mapping[str, Any]) -> float:
    pitch = _pitch(camera)
    return own.focal_length_px * (pitch / 1000 if pitch else 1.0)


def _stereo_angle(recording: xr.Dataset, depth: float) -> float | None:
    """Return the angle between the rays of the outermost positions to a point in front of their middle, degrees."""
    if "stage_x_mm" not in recording.coords or recording.sizes.get("s", 1) < 2:
        return None
    span = float(np.ptp(recording["stage_x_mm"].values))
    return math.degrees(2 * math.atan(0.5 * span / depth)) if math.isfinite(depth) else None


def _feature_size(scene: Mapping[str, Any]) -> str | None:
    """Return the wavelengths of noise textures, as far as they are in mm."""
    sizes = [
        _part(item, "texture").get("wavelength_mm") for item in scene.get("objects") or () if isinstance(item, Mapping)
    ]
    listed = sorted(
        {f"{low:g} to {high:g}" for low, high in (size for size in sizes if isinstance(size, list) and len(size) == 2)}
    )
    return "wavelengths " + ", ".join(listed) if listed else None


_OWN = ("plane_sweep", "refined", "structure_tensor")
_SURFACES = {
    "auto": "plane or second order, per pixel",
    "constant": "constant",
    "plane": "linear",
    "curved": "second order",
}
_MOTIONS = {
    "auto": "rigid with isotropic growth or affine, per pixel",
    "translation": "constant",
    "rigid": "rigid",
    "growing": "rigid with isotropic growth",
    "affine": "affine",
}
_GAINS = {"per_image": "gain and offset of every image", "none": "one brightness for all images"}
_INTERPOLANTS = {"quintic": "quintic B-spline", "cubic": "cubic B-spline"}


def _analysis(estimate: xr.Dataset | None, strain: xr.Dataset | None) -> Iterator[ReportField]:
    attrs: Mapping[str, Any] = {} if estimate is None else {str(key): value for key, value in estimate.attrs.items()}
    settings = {} if estimate is None else read_method_settings(estimate)
    method = str(attrs.get("method", ""))
    measured = {} if strain is None else {str(key): value for key, value in strain.attrs.items()}

    def field(name: str, value: Any, unit: str = "", missing: str = _NOT_ESTIMATED) -> ReportField:
        text = _text(value, missing)
        stated = text != missing
        return ReportField(
            "analysis", name, text, unit if stated else "", "strain" if missing == _NO_STRAIN else "estimate"
        )

    yield field("Software", f"scenetruth, method {method}" if method in _OWN else method or None)
    yield field("Image filtering", settings.get("image_filter"))
    subset = math.nan if estimate is None else read_subset_px(estimate)
    yield field("Subset size", subset, "px")
    yield field("Subset window", _window(settings))
    yield field("Subset shape function", _shape_function(method, settings))
    yield field("Matching criterion", _criterion(method, settings))
    yield field("Interpolant", _INTERPOLANTS.get(str(settings.get("spline"))))
    yield field("Step size", measured.get("step_px"), "px", _NO_STRAIN)
    window = measured.get("window")
    yield field("Strain window", None if window is None else f"{window} x {window} points", "", _NO_STRAIN)
    weights = measured.get("weights")
    order = measured.get("order")
    fit = None if weights is None else f"polynomial of order {order}, {weights} weights"
    yield field("Strain filter", fit, "", _NO_STRAIN)
    measure = measured.get("measure")
    yield field("Strain formulation", None if measure is None else MEASURES[measure], "", _NO_STRAIN)
    if "subset_px" in measured:
        yield field("Virtual strain gauge", measured.get("gauge_length_px"), "px", _NO_STRAIN)
        yield field("Virtual strain gauge on the object", measured.get("gauge_length_mm"), "mm", _NO_STRAIN)
    else:
        missing = _NO_STRAIN if strain is None else _NOT_ESTIMATED
        yield field("Virtual strain gauge", None, "", missing)
        yield field("Virtual strain gauge on the object", None, "", missing)


def _shape_function(method: str, settings: Mapping[str, Any]) -> str | None:
    """Return the models of disparity and motion within a window, as far as the settings state them."""
    if method == "structure_tensor":
        return "constant disparity and flow"
    surface, motion = (
        names.get(str(settings.get(key))) for key, names in (("surface", _SURFACES), ("motion", _MOTIONS))
    )
    return f"disparity: {surface}; motion: {motion}" if method == "refined" and surface and motion else None


def _criterion(method: str, settings: Mapping[str, Any]) -> str | None:
    if method == "structure_tensor":
        return "total least squares of the brightness gradient"
    gains = _GAINS.get(str(settings.get("photometric_model")))
    return f"least squares over all images, {gains}" if method == "refined" and gains else None


def _window(settings: Mapping[str, Any]) -> str | None:
    sigma = settings.get("window_sigma_px")
    return f"Gaussian, standard deviation {sigma:g} px" if isinstance(sigma, int | float) else None


def _noise_floors(
    estimate: xr.Dataset | None, strain: xr.Dataset | None, recording: xr.Dataset, depth: float
) -> Iterator[ReportField]:
    """Yield the medians of the stated standard deviations over valid pixels."""

    def field(name: str, value: float, unit: str, missing: str, source: str) -> ReportField:
        text = _text(value, missing)
        return ReportField("noise floor", name, text, "" if text == missing else unit, source)

    of_estimate = "median of the stated standard deviations"
    stated = estimate if estimate is not None and "velocity_std" in estimate else None
    scale = read_intrinsics(recording).focal_length_px / depth
    for k, name in enumerate("UVW"):
        value = math.nan if stated is None else _median_of(stated, partial(_velocity_std, k))
        yield field(f"Displacement {name} per frame", value, "mm", _NOT_ESTIMATED, of_estimate)
        if name != "W":
            yield field(
                f"Displacement {name} per frame at the image scale", value * scale, "px", _NOT_ESTIMATED, of_estimate
            )
    stated = estimate if estimate is not None and "depth_std" in estimate else None
    value = math.nan if stated is None else _median_of(stated, _depth_std)
    yield field("Depth", value, "mm", _NOT_ESTIMATED, of_estimate)
    for name in ("exx", "eyy", "exy"):
        has = strain is not None and f"{name}_std" in strain
        value = _median(strain[f"{name}_std"].values) if strain is not None and has else math.nan
        unit = str(strain[name].attrs["units"]) if strain is not None else ""
        yield field(f"Strain {name}", value, unit, _NO_STRAIN if strain is None else _NOT_ESTIMATED, of_estimate)


def _median(values: Any) -> float:
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(np.median(finite)) if finite.size else math.nan
