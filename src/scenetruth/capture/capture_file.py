"""The model of a capture file: a folder of real images, with camera, stage, frames and file names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from scenetruth.camera import Camera, Distortion, Frames, Stage, StageErrors
from scenetruth.capture.board_artwork import BoardPrint
from scenetruth.capture.file_patterns import TIME_FIELD, read_pattern
from scenetruth.capture.image_reading import PixelFormat
from scenetruth.errors import CaptureError, Problem
from scenetruth.input_files import InputFile, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene import Overrides, join_override_problems, override, read_input
from scenetruth.valid_remainder import FieldRepair, Keys, Reading, copied, read_model
from scenetruth.validated_model import Finite, FrozenModel, NonNegative, Positive

__all__ = [
    "CAPTURE_FILE",
    "BoardSection",
    "Capture",
    "CaptureCamera",
    "CaptureFiles",
    "CaptureFrames",
    "CaptureLike",
    "CaptureReading",
    "CaptureStage",
    "StripSection",
    "load_capture",
    "read_capture",
]

CAPTURE_FILE = "capture.yaml"
"""Name of the capture file in the folder of a capture."""


def _pattern_type(*allowed: str, required: tuple[str, ...] = ()) -> Any:
    """Return the type of a file pattern with certain fields."""

    def check(value: str) -> str:
        read_pattern(value, allowed, required)
        return value

    return Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(check)]


class CaptureCamera(FrozenModel):
    """Camera: size and format of the images, and intrinsics as far as they are given in advance."""

    width: Annotated[int, Field(ge=1, le=32768)]
    """Image width W in px."""
    height: Annotated[int, Field(ge=1, le=32768)]
    """Image height H in px."""
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 8
    """Bits per digital number of the camera, which may be fewer than those of the files."""
    encoding: Literal["linear", "srgb", "gamma"] = "linear"
    """Relation of digital numbers to radiance: proportional, sRGB, or full scale (x / full scale)^(1 / gamma)."""
    gamma: Annotated[float, Field(ge=0.2, le=5)] = 2.2
    """Exponent of the encoding ``gamma``."""
    black_level_dn: NonNegative = 0.0
    """Digital number without light; dark frames replace it where they exist."""
    bayer: Literal["rggb", "grbg", "gbrg", "bggr"] | None = None
    """Colours of a Bayer mosaic in row-major order from the upper left; null for grey or RGB images."""
    plane: Literal["mosaic", "red", "green", "blue"] = "mosaic"
    """Pixels of a mosaic that are used: all, or those of one colour at half the resolution."""
    exposure_time_s: Positive | None = None
    """Exposure time of the images in s; null if it is not stated."""
    line_time_s: NonNegative = 0.0
    """Time in s between the exposures of consecutive rows (rolling shutter); 0 for a global shutter."""
    focal_length_px: Positive | None = None
    """Focal length f in px; from a data sheet it is the start of a calibration."""
    focal_length_mm: Positive | None = None
    """Focal length in mm; requires ``pixel_pitch_um``."""
    pixel_pitch_um: Positive | None = None
    """Pixel pitch of the sensor in µm."""
    principal_point_px: tuple[Finite, Finite] | None = None
    """(c_x, c_y) in pixel indices; default: the image centre ((W-1)/2, (H-1)/2)."""
    distortion: Distortion | None = None
    """Lens distortion; null for an ideal pinhole."""
    focal_length_std_px: NonNegative | None = None
    """Standard deviation of the focal length in px; null if it is not stated."""
    principal_point_std_px: NonNegative | None = None
    """Standard deviation of both coordinates of the principal point in px; null if it is not stated."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.plane != "mosaic" and self.bayer is None:
            msg = "`plane` needs the order of the mosaic: set `bayer`"
            raise ValueError(msg)
        if self.black_level_dn >= 2**self.bit_depth - 1:
            msg = f"`black_level_dn` must be below full scale, {2**self.bit_depth - 1} at {self.bit_depth} bits"
            raise ValueError(msg)
        if self.focal_length_px is None and self.focal_length_mm is None and self.pixel_pitch_um is None:
            return self
        self.to_camera()
        return self

    @property
    def pixels(self) -> PixelFormat:
        """Format of the pixels."""
        return PixelFormat(self.bit_depth, self.encoding, self.gamma, self.bayer, self.plane)

    def to_camera(self) -> Camera:
        """Return the camera model; raises ValueError without a focal length."""
        names = ("width", "height", "focal_length_px", "focal_length_mm", "pixel_pitch_um", "principal_point_px")
        try:
            return Camera(**{name: getattr(self, name) for name in names}, distortion=self.distortion)
        except ValidationError as error:
            raise ValueError(error.errors()[0]["msg"].removeprefix("Value error, ")) from error


class CaptureStage(Stage):
    """Linear stage: positions, order of the scan, and tolerances."""

    step_std: NonNegative = 1e-4
    """Relative standard deviation of the step length (scale of the stage)."""
    positions_file: InputFile | None = None
    """CSV file with measured positions, columns ``s`` (as in the file names) and ``x_mm``; null for the planned
    positions."""
    axis_tilt_urad: None = None
    """Not available: the direction of the axis is a result of the calibration."""
    poses: None = None
    """Not available: actual poses are a result of the calibration."""


class CaptureFrames(Frames):
    """Frame times."""

    times: Literal["planned", "name", "exif", "file"] = "planned"
    """Source of the time of every image: plan of the stage, field ``{time:FORMAT}`` of the names, Exif, or
    ``times_file``."""
    times_file: InputFile | None = None
    """CSV file with times, columns ``s``, ``t`` (as in the file names), ``time_s``, and ``row`` for a grid."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.times == "file") != (self.times_file is not None):
            msg = "`times_file` belongs to `times: file`: give both or neither"
            raise ValueError(msg)
        return self


class BoardSection(BoardPrint):
    """Calibration board: grid of squares or dots, and tolerances of its print."""

    scale_std: Positive = 1e-3
    """Relative standard deviation of the size of the board: 1e-3 printed, 1e-4 measured."""
    warp_mm: NonNegative = 0.2
    """Standard deviation of the deviation from a plane in mm: 0.02 glass, 0.2 paper on a plate."""


class StripSection(FrozenModel):
    """Fiducial strip: points in the image at every visit of the stage."""

    file: InputFile
    """CSV file of its points, columns ``x_mm``, ``y_mm``, ``z_mm``."""
    scale_std: Positive = 1e-4
    """Relative standard deviation of its size."""
    warp_mm: NonNegative = 0.02
    """Standard deviation of the deviation from a plane in mm."""
    errors: StageErrors | None = None
    """Errors of the stage that may be new at every visit of the measurement, which the strip determines; null for
    those of ``stage.errors``."""


class CaptureFiles(FrozenModel):
    """Patterns of the image files, relative to the folder of the capture file.

    Fields in braces are integers: ``{s}`` camera position, ``{t}`` frame, ``{row}`` row of a grid, ``{pose}`` pose of a
    board, ``{level}`` exposure level. ``{s:+d}`` or ``{t:03d}`` match numbers of this form only; ``*`` and ``?`` match
    any text.
    """

    images: _pattern_type("s", "t", "row", TIME_FIELD)  # type: ignore[valid-type]
    """Images of the measurement: ``images/s{s:+d}_t{t:+d}.tif``. Positions s increase along the stage."""
    first_position: int | None = None
    """Index of the first position in the names, where its images may be missing; null for 0, 1, or symmetric
    around 0."""
    first_frame: int | None = None
    """Index of the first frame in the names, likewise."""
    board: _pattern_type("pose", "s", "row", required=("pose",)) | None = None  # type: ignore[valid-type]
    """Images of the calibration board: ``board/p{pose:02d}_s{s:+d}.tif``."""
    dark: _pattern_type("level") | None = None  # type: ignore[valid-type]
    """Images without light: ``dark/*.tif``."""
    flat: _pattern_type("level") | None = None  # type: ignore[valid-type]
    """Images of a uniformly bright surface: ``flat/*.tif``, or ``flat/e{level}_*.tif`` at several exposures."""
    static: _pattern_type("level") | None = None  # type: ignore[valid-type]
    """Images of a scene at rest, with the stage at rest, for the noise: ``static/*.tif``."""
    mask: InputFile | None = None
    """Image of the pixels that must not be used: not 0 where a pixel is excluded."""
    exposure_times_s: tuple[Positive, ...] = ()
    """Exposure times in s of the levels of flats and darks, in increasing order of ``{level}``."""


class Capture(FrozenModel):
    """Capture: a folder of real images, with its camera and stage.

    See Also
    --------
    load_capture : Load a capture from its folder.
    scenetruth.read_images : Read images without a capture file.

    Examples
    --------
    >>> plain = {"camera": {"width": 640, "height": 480, "bit_depth": 12, "focal_length_px": 5000}}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 9, "frame_interval_s": 60}}
    >>> capture = Capture.from_dict({**plain, "files": {"images": "images/s{s:+d}_t{t:+d}.tif"}})
    >>> capture.camera.bit_depth, capture.stage.x_mm.tolist()
    (12, [-10.0, -5.0, 0.0, 5.0, 10.0])
    """

    # Replaces the docstring in the JSON schema.
    model_config = ConfigDict(json_schema_extra={"description": "A folder of real images, with its camera and stage."})

    format: Literal[1] = 1
    """Version of the capture format."""
    description: Annotated[str, Field(max_length=10_000)] = ""
    """Description of the measurement."""
    camera: CaptureCamera
    """Camera."""
    stage: CaptureStage
    """Linear stage."""
    frames: CaptureFrames
    """Frames and their times."""
    files: CaptureFiles
    """Patterns of the image files."""
    board: BoardSection | None = None
    """Calibration board; null for none."""
    strip: StripSection | None = None
    """Fiducial strip; null for none."""
    distance_mm: Positive | None = None
    """Distance of the surface in mm, as measured with a ruler; null if it is not measured."""

    _folder: Path | None = PrivateAttr(default=None)

    @field_validator("files")
    @classmethod
    def _fields_of_images(cls, value: CaptureFiles, info: ValidationInfo) -> CaptureFiles:
        fields = read_pattern(value.images, ("s", "t", "row", TIME_FIELD)).fields
        given = info.data
        counts = {
            "s": given["stage"].positions if "stage" in given else 1,
            "row": given["stage"].rows if "stage" in given else 1,
            "t": given["frames"].count if "frames" in given else 1,
        }
        lacking = [f"{{{name}}} for {count}" for name, count in counts.items() if count > 1 and name not in fields]
        if lacking:
            msg = f"`images` lacks {', '.join(lacking)}"
            raise ValueError(msg)
        if "frames" in given and given["frames"].times == "name" and TIME_FIELD not in fields:
            msg = "`images` lacks {time:FORMAT}, from which `frames.times: name` takes the times"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _board_and_files(self) -> Self:
        if (self.board is None) != (self.files.board is None):
            msg = "`board` describes the images of `files.board`: give both or neither"
            raise ValueError(msg)
        return self

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return Path() if self._folder is None else self._folder

    def to_dict(self) -> dict[str, Any]:
        """Return the capture as plain values, without default values."""
        return self.model_dump(mode="json", exclude_defaults=True)

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], *, source: str | Path | None = None, folder: Path | None = None
    ) -> Capture:
        """Validate a capture given as plain values.

        Parameters
        ----------
        values
            The values, as in a file.
        source
            Origin of the values, for messages.
        folder
            Directory of the image files; default: the current directory.

        Returns
        -------
        Capture
            The capture; image files are not read.

        Raises
        ------
        CaptureError
            If the values are invalid; lists every problem with its path.

        See Also
        --------
        load_capture : Load a capture from its folder.

        Examples
        --------
        >>> import scenetruth as st
        >>> try:
        ...     Capture.from_dict({"camera": {"width": 640, "hight": 480}})
        ... except st.CaptureError as error:
        ...     print(error.problems[0])
        camera.hight: unknown key; did you mean 'height'? (got 480)
        """
        return _validated(values, source, folder).required()


class CaptureReading(Reading[Capture]):
    """A capture with its problems."""

    refused = CaptureError


_STEPS = ("positions", "positions_mm", "baseline_mm")


class _CaptureRepair(FieldRepair):
    """Values of a capture, in which fields with errors are removed or replaced."""

    required: ClassVar[Mapping[str, Any]] = {
        "camera.width": 64,
        "camera.height": 48,
        "stage": {"positions": 1, "baseline_mm": 1.0},
        "frames": {"count": 1},
        "frames.count": 1,
        "files.images": f"{{row}}_{{s}}_{{t}}_{{{TIME_FIELD}:%Y}}.png",
        "board": {"kind": "checkerboard", "squares": [4, 4], "square_mm": 5.0},
    }

    def apply(self, keys: Keys, error: str) -> None:
        """Remove or replace a field with an error; of files that contradict the stage, the pattern of the images."""
        if tuple(keys) == ("files",) and isinstance(self.plain.get("files"), dict):
            self.done.add((error, *keys))
            super().apply(("files", "images"), error)
            return
        if tuple(keys[:1]) == ("stage",) and keys[1:2] and keys[1] in _STEPS:
            # They determine each other.
            self.done.add((error, *keys))
            self.wrong.add(tuple(keys))
            keys = ("stage",)
        tables = self._tables(keys)
        super().apply(keys, error)
        if len(keys) == 1:
            for section, fields in tables.items():
                self.plain[section] |= fields

    def is_shown(self, keys: Keys, error: str) -> bool:
        """Return whether an error that follows a repair is one of the capture."""
        if tuple(keys) == ("files",) and self.is_wrong("files", "images"):
            return False
        return super().is_shown(keys, error) and (bool(keys) or not self.is_wrong("board"))

    def resolve(self) -> None:
        """Add a board where its images have a pattern, and remove one without a pattern."""
        if (self.plain.get("files") or {}).get("board") is None:
            self.plain.pop("board", None)
        else:
            self.plain["board"] = copied(self.required["board"])

    def _tables(self, keys: Keys) -> dict[str, dict[str, Any]]:
        """Return the tables that a section names, which do not depend on its other fields."""
        found = {}
        for section, name, more in (("stage", "positions_file", {}), ("frames", "times_file", {"times": "file"})):
            given = self.plain.get(section)
            if tuple(keys) == (section,) and isinstance(given, dict) and isinstance(given.get(name), str):
                found[section] = {name: given[name], **more}
        return found


def _validated(values: Any, source: str | Path | None = None, folder: Path | None = None) -> CaptureReading:
    if not isinstance(values, Mapping):
        problem = Problem("", "must be a mapping of camera, stage, frames, files", values)
        return CaptureReading(None, (problem,), _CaptureRepair({}), source)
    repair = _CaptureRepair(values)
    problems = plain_problems(values)
    if problems:
        return CaptureReading(None, tuple(problems), repair, source)
    capture, problems = read_model(Capture, values, repair, context=validation_context(folder))
    if capture is not None:
        capture._folder = folder
    return CaptureReading(capture, tuple(problems), repair, source)


CaptureLike = Capture | Mapping[str, Any] | str | PathLike[str]
"""A capture, its values, its folder, or the path of its file."""


def load_capture(capture: CaptureLike, *, overrides: Overrides = ()) -> Capture:
    """Load a capture: the file ``capture.yaml`` of a folder of real images.

    Parameters
    ----------
    capture
        Folder that contains ``capture.yaml``, or the path of such a file. File patterns refer to its folder. Also a
        mapping of values, or a capture.
    overrides
        Overrides of fields, as for `scenetruth.load_scene`.

    Returns
    -------
    Capture
        The capture; image files are not read.

    Raises
    ------
    CaptureError
        If the file cannot be read or is invalid; lists every problem with its path.

    See Also
    --------
    scenetruth.capture.check_capture : Checks the image files of a capture.
    scenetruth.capture.import_capture : Reads them as a recording.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = '''
    ... camera: {width: 640, height: 480, bit_depth: 12, focal_length_px: 5000}
    ... stage: {positions_mm: [-10, -5, 0, 5, 10]}
    ... frames: {count: 9, frame_interval_s: 60}
    ... files: {images: "images/s{s:+d}_t{t:+d}.tif"}
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "capture.yaml").write_text(text)
    ...     load_capture(folder).stage.positions
    5
    """
    return read_capture(capture, overrides=overrides).required()


def read_capture(capture: CaptureLike, *, overrides: Overrides = ()) -> CaptureReading:
    """Read a capture as `load_capture` does, without an error for one that is invalid."""
    if isinstance(capture, Capture) and not overrides:
        return CaptureReading(capture, (), _CaptureRepair({}))
    given: Any = capture.to_dict() if isinstance(capture, Capture) else capture
    if isinstance(given, str | PathLike) and Path(given).is_dir():
        file = Path(given) / CAPTURE_FILE
        if not file.exists():
            message = f"has no {CAPTURE_FILE}; write one: scenetruth capture init {given}"
            raise CaptureError([Problem("FOLDER", message, str(given))])
        given = file
    plain, source, folder = read_input(given, "a capture file", CaptureError)
    plain, wrong = override(plain, overrides)
    reading = _validated(plain, source, capture._folder if isinstance(capture, Capture) else folder)
    return replace(reading, problems=tuple(join_override_problems(wrong, reading.problems)))
