"""Cameras in the files of other programs: OpenCV, Kalibr, COLMAP, MATLAB, MatchID and DICe."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from scenetruth.camera import Camera, Distortion
from scenetruth.capture.calibration.calibration_result import RigCalibration
from scenetruth.capture.calibration.rig_model import CalibrationError
from scenetruth.errors import EstimateWarning, Problem
from scenetruth.output import write_atomically
from scenetruth.schema.plausible_units import describe_rig
from scenetruth.validation_problems import list_problems

__all__ = ["export_calibration", "import_calibration", "import_camera"]

ForeignFormat = Literal["opencv", "kalibr", "colmap", "matlab", "matchid", "dice"]

_LARGEST_BYTES = 10_000_000
_ASPECT = 1e-3
"""Largest relative difference of f_x and f_y of a camera, which has one focal length."""
_MOST_ASPECT = 0.1
"""Largest relative difference of f_x and f_y of a calibration, whose pixels may have different sides."""
_FOCAL_STD, _CENTRE_STD = 1e-3, 5.0
"""Standard deviations of an imported camera without a stated uncertainty: relative, and px."""
_OPENCV_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_PRISM_AND_TILT = ("s1", "s2", "s3", "s4", "tau_x", "tau_y")
_COLMAP_MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "c_x", "c_y"),
    "PINHOLE": ("f_x", "f_y", "c_x", "c_y"),
    "SIMPLE_RADIAL": ("f", "c_x", "c_y", "k1"),
    "RADIAL": ("f", "c_x", "c_y", "k1", "k2"),
    "OPENCV": ("f_x", "f_y", "c_x", "c_y", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("f_x", "f_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}


class _UnrepresentableError(ValueError):
    """A value that the camera model lacks, or that is missing."""


def import_calibration(
    path: str | PathLike[str], positions_mm: ArrayLike, *, source: ForeignFormat | None = None, camera: int = 0,
    size: tuple[int, int] | None = None, std: Mapping[str, float] | None = None,
) -> RigCalibration:  # fmt: skip
    """Import a camera of another program as a calibration on an ideal stage.

    Parameters
    ----------
    path
        File of the other program.
    positions_mm
        X of the stage positions in mm.
    source
        Program; default: from the name and content of the file.
    camera
        Index of the camera in a file with several.
    size
        Image width and height in px; required for files without a size, must agree otherwise.
    std
        Standard deviations of intrinsic parameters by name; default: 0.1 % of the focal length and 5 px of the
        principal point, because these files have no covariance.

    Returns
    -------
    RigCalibration
        The calibration; pass it as ``guess`` of `calibrate` to refine it with boards.

    Raises
    ------
    ValueError
        A `CalibrationError` if the file is unreadable or its camera cannot be represented.

    See Also
    --------
    import_camera : Returns the camera only.
    export_calibration : Writes a file of another program.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.capture.calibration import import_calibration
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "cameras.txt"
    ...     _ = file.write_text("1 RADIAL 640 480 5000 320 240 -0.5 3.0")
    ...     found = import_calibration(file, [-5, 0, 5])
    >>> found.camera.principal_point, found.std("f")
    ((319.5, 239.5), 5.0)
    """
    found, f_x, f_y = _read_camera(path, source, camera, size, _MOST_ASPECT)
    found = found.model_copy(update={"focal_length_px": f_x})
    deviations = {"f": _FOCAL_STD * f_x, "c_x": _CENTRE_STD, "c_y": _CENTRE_STD} if std is None else std
    square = RigCalibration.from_camera(found, positions_mm, std=deviations)
    values = square.values.copy()
    values[square.names.index("aspect")] = f_y / f_x - 1
    return replace(square, values=values)


def import_camera(
    path: str | PathLike[str], *, source: ForeignFormat | None = None, camera: int = 0,
    size: tuple[int, int] | None = None,
) -> Camera:  # fmt: skip
    """Read a camera from a file of another program.

    Parameters
    ----------
    path
        File of the other program.
    source
        Program; default: from the name and content of the file.
    camera
        Index of the camera in a file with several.
    size
        Image width and height in px; required for files without a size, must agree otherwise.

    Returns
    -------
    scenetruth.camera.Camera
        Camera with pixel centres at integers.

    Raises
    ------
    ValueError
        A `CalibrationError` if the file is unreadable or its camera cannot be represented.

    See Also
    --------
    import_calibration : Returns a calibration with an uncertainty.

    Examples
    --------
    Pixel centres are integers, whereas the upper left corner of an image of COLMAP is its origin:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.capture.calibration import import_camera
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "cameras.txt"
    ...     _ = file.write_text("1 PINHOLE 640 480 5000 5000 320 240")
    ...     print(import_camera(file).principal_point)
    (319.5, 239.5)
    """
    return _read_camera(path, source, camera, size, _ASPECT)[0]


def _read_camera(
    path: str | PathLike[str], source: ForeignFormat | None, camera: int, size: tuple[int, int] | None, aspect: float
) -> tuple[Camera, float, float]:
    """Return a camera with the mean focal length, and the focal lengths along x and y, which may differ in part."""
    file = Path(path)
    try:
        if file.stat().st_size > _LARGEST_BYTES:
            raise CalibrationError([Problem("", f"has more than {_LARGEST_BYTES:,} bytes; check the path")], file)
        chosen = source or _guess_source(file)
        if chosen not in get_args(ForeignFormat):
            message = f"must be one of {', '.join(get_args(ForeignFormat))}"
            raise CalibrationError([Problem("source", message, chosen)], file)
        fields = _READERS[chosen](file, camera)
        found, f_x, f_y = _camera(fields, size, aspect)
    except OSError as error:
        raise CalibrationError([Problem("", f"cannot be read: {error.strerror or error}")], file) from error
    except _UnrepresentableError as error:
        raise CalibrationError([Problem(f"camera {camera}", str(error))], file) from error
    except ValidationError as error:
        raise CalibrationError(list_problems(error), file) from error
    except (KeyError, IndexError, TypeError, ValueError) as error:
        if isinstance(error, CalibrationError):
            raise
        message = f"is no file of this program ({chosen}): {type(error).__name__} {error}"
        raise CalibrationError([Problem("", message)], file) from error
    for message in describe_rig(found.focal_px, None, found.width, found.height):
        warnings.warn(f"{file.name}: {message}", EstimateWarning, stacklevel=3)
    return found, f_x, f_y


def _guess_source(file: Path) -> ForeignFormat:
    """Return the program that wrote a file, by suffix and content."""
    start = file.read_bytes()[:4000].decode("utf-8", errors="replace")
    if file.suffix == ".caldat" or "Cam0_Fx" in start or "Cam1_Fx" in start:
        return "matchid"
    if file.suffix in (".mat", ".json"):
        return "matlab"
    if "LENS_DISTORTION_MODEL" in start or "<ParameterList" in start:
        return "dice"
    if "camera_model" in start and "intrinsics" in start:
        return "kalibr"
    if file.suffix == ".txt":
        return "colmap"
    if "opencv" in start.lower() or file.suffix in (".yml", ".yaml", ".xml"):
        return "opencv"
    message = f"is of an unknown program; set source to one of {', '.join(get_args(ForeignFormat))}"
    raise CalibrationError([Problem("source", message)], file)


def _camera(fields: dict[str, float], size: tuple[int, int] | None, aspect: float) -> tuple[Camera, float, float]:
    """Return the camera of named values and its focal lengths; the principal point refers to centres at integers."""
    for name in (*_PRISM_AND_TILT, "skew"):
        if fields.get(name, 0.0) != 0:
            message = f"{name} is {fields[name]:g}; the camera model has no such term: calibrate with boards instead"
            raise _UnrepresentableError(message)
    f_x, f_y = (fields.get(name, fields.get("f", math.nan)) for name in ("f_x", "f_y"))
    if not (math.isfinite(f_x) and math.isfinite(f_y) and min(f_x, f_y) > 0):
        message = f"focal lengths must be positive (got {f_x:g} and {f_y:g})"
        raise _UnrepresentableError(message)
    if abs(f_x / f_y - 1) > aspect:
        message = f"f_x = {f_x:g} and f_y = {f_y:g} differ by more than {100 * aspect:g} %"
        message += "; pixels must be square: use import_calibration" if aspect == _ASPECT else "; check the file"
        raise _UnrepresentableError(message)
    given = (fields["width"], fields["height"]) if "width" in fields else size
    if given is None:
        message = "the file has no image size: give `size`"
        raise _UnrepresentableError(message)
    if size is not None and tuple(int(value) for value in given) != tuple(size):
        message = f"images have {int(given[0])} x {int(given[1])} px, not {size[0]} x {size[1]}: another camera or crop"
        raise _UnrepresentableError(message)
    coefficients = {name: fields.get(name, 0.0) for name in _OPENCV_ORDER}
    found = Camera(
        width=int(given[0]), height=int(given[1]), focal_length_px=math.sqrt(f_x * f_y),
        principal_point_px=(fields["c_x"], fields["c_y"]),
        distortion=Distortion(**coefficients) if any(coefficients.values()) else None,
    )  # fmt: skip
    return found, f_x, f_y


def _opencv_coefficients(values: Sequence[float]) -> dict[str, float]:
    if len(values) not in (0, 4, 5, 8, 12, 14):
        message = f"{len(values)} distortion coefficients; OpenCV has 4, 5, 8, 12 or 14"
        raise _UnrepresentableError(message)
    return dict(zip((*_OPENCV_ORDER, *_PRISM_AND_TILT), map(float, values), strict=False))


def _matrix_fields(matrix: Any) -> dict[str, float]:
    values = np.asarray(matrix, dtype=np.float64).reshape(3, 3)
    return {
        "f_x": float(values[0, 0]), "f_y": float(values[1, 1]), "skew": float(values[0, 1]),
        "c_x": float(values[0, 2]), "c_y": float(values[1, 2]),
    }  # fmt: skip


def _first(values: Mapping[str, Any], names: Sequence[str]) -> Any:
    """Return the value of the first name that exists; names are compared without case and underscores."""
    plain = {re.sub(r"[_\s]", "", str(key)).lower(): value for key, value in values.items()}
    for name in names:
        if name in plain:
            return plain[name]
    message = f"has none of {', '.join(names)}"
    raise _UnrepresentableError(message)


def _read_opencv(file: Path, camera: int) -> dict[str, float]:
    values = _opencv_xml(file) if file.read_bytes().lstrip()[:1] == b"<" else _opencv_yaml(file)
    number = str(camera + 1)
    if any(str(key).lower().replace("_", "") in ("fisheye", "xi") and value for key, value in values.items()):
        message = "fisheye and omnidirectional models cannot be represented"
        raise _UnrepresentableError(message)
    matrix = _first(values, ("cameramatrix", f"cameramatrix{number}", f"m{number}", f"k{number}", "k", "intrinsics"))
    names = ("distortioncoefficients", f"distortioncoefficients{number}", f"distcoeffs{number}", "distcoeffs")
    coefficients = _first(values, (*names, f"d{number}", "d", "dist"))
    fields = _matrix_fields(matrix) | _opencv_coefficients(np.asarray(coefficients, dtype=np.float64).ravel().tolist())
    plain = {re.sub(r"[_\s]", "", str(key)).lower(): value for key, value in values.items()}
    if "imagewidth" in plain and "imageheight" in plain:
        fields |= {"width": float(plain["imagewidth"]), "height": float(plain["imageheight"])}
    elif "imagesize" in plain and len(plain["imagesize"]) == 2:
        fields |= {"width": float(plain["imagesize"][0]), "height": float(plain["imagesize"][1])}
    return fields


def _opencv_yaml(file: Path) -> dict[str, Any]:
    import yaml

    class Loader(yaml.SafeLoader):
        """Loader of the matrices of OpenCV."""

    def matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
        plain = loader.construct_mapping(node, deep=True)
        return plain["data"]

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", matrix)
    text = re.sub(r"^%YAML[:\s].*$", "", file.read_text(encoding="utf-8-sig"), count=1, flags=re.MULTILINE)
    try:
        values = yaml.load(text, Loader=Loader)
    except (yaml.YAMLError, RecursionError) as error:
        message = f"is not valid YAML: {' '.join(str(error).split())[:200]}"
        raise _UnrepresentableError(message) from error
    if not isinstance(values, dict):
        message = "has no named values"
        raise _UnrepresentableError(message)
    return {
        str(key): value["data"] if isinstance(value, dict) and "data" in value else value
        for key, value in values.items()
    }


def _xml_root(file: Path) -> Any:
    from xml.etree import ElementTree

    text = file.read_text(encoding="utf-8-sig")
    if "<!ENTITY" in text or "<!DOCTYPE" in text:
        message = "has a document type, which is not read: remove it"
        raise _UnrepresentableError(message)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        message = f"is not valid XML: {error}"
        raise _UnrepresentableError(message) from error


def _opencv_xml(file: Path) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for child in _xml_root(file):
        data = child.find("data")
        text = (child.text if data is None else data.text) or ""
        numbers = [float(word) for word in text.split() if re.fullmatch(r"[-+.\deE]+", word)]
        values[child.tag] = numbers if data is not None or len(numbers) != 1 else numbers[0]
    return values


def _read_kalibr(file: Path, camera: int) -> dict[str, float]:
    values = _opencv_yaml(file)
    chosen = values.get(f"cam{camera}", values)
    model, distortion = chosen["camera_model"], chosen.get("distortion_model", "none")
    if model != "pinhole" or distortion not in ("radtan", "none"):
        message = f"model {model} with {distortion} cannot be represented; calibrate as pinhole with radtan"
        raise _UnrepresentableError(message)
    f_x, f_y, c_x, c_y = (float(value) for value in chosen["intrinsics"])
    coefficients = [] if distortion == "none" else [float(value) for value in chosen["distortion_coeffs"]]
    width, height = chosen["resolution"]
    plain = {"f_x": f_x, "f_y": f_y, "c_x": c_x, "c_y": c_y, "width": float(width), "height": float(height)}
    return plain | _opencv_coefficients(coefficients)


def _read_colmap(file: Path, camera: int) -> dict[str, float]:
    lines = [line.split() for line in file.read_text(encoding="utf-8").splitlines()]
    rows = [words for words in lines if words and not words[0].startswith("#")]
    if camera >= len(rows):
        message = f"the file has {len(rows)} cameras"
        raise _UnrepresentableError(message)
    _, model, width, height, *numbers = rows[camera]
    if model not in _COLMAP_MODELS:
        message = f"model {model} cannot be represented; use one of {', '.join(_COLMAP_MODELS)}"
        raise _UnrepresentableError(message)
    names = _COLMAP_MODELS[model]
    fields = dict(zip(names, map(float, numbers), strict=True))
    # The upper left corner of the image is the origin: its first pixel has its centre at (0.5, 0.5).
    return fields | {
        "c_x": fields["c_x"] - 0.5, "c_y": fields["c_y"] - 0.5, "width": float(width), "height": float(height),
    }  # fmt: skip


def _read_matlab(file: Path, camera: int) -> dict[str, float]:
    if file.suffix == ".mat":
        from scipy.io import loadmat

        content = loadmat(file, simplify_cells=True)
        found = [value for key, value in content.items() if not key.startswith("__") and isinstance(value, dict)]
    else:
        content = json.loads(file.read_text(encoding="utf-8"))
        found = content if isinstance(content, list) else [content]
    if camera >= len(found):
        message = f"the file has {len(found)} structs; save toStruct(cameraParams) as a struct or with jsonencode"
        raise _UnrepresentableError(message)
    values = found[camera]
    values = values.get("Intrinsics", values)
    plain = {str(key).lower(): value for key, value in values.items()}
    if "k" in plain:
        fields = _matrix_fields(plain["k"])
    elif "intrinsicmatrix" in plain:
        # The older property is the transposed matrix.
        fields = _matrix_fields(np.asarray(plain["intrinsicmatrix"], dtype=np.float64).T)
    else:
        (f_x, f_y), (c_x, c_y) = plain["focallength"], plain["principalpoint"]
        fields = {"f_x": float(f_x), "f_y": float(f_y), "c_x": float(c_x), "c_y": float(c_y)}
        fields["skew"] = float(plain.get("skew", 0.0))
    # Pixel centres begin at 1.
    fields["c_x"], fields["c_y"] = fields["c_x"] - 1, fields["c_y"] - 1
    fields |= dict(
        zip(("k1", "k2", "k3"), np.atleast_1d(plain["radialdistortion"]).astype(float).tolist(), strict=False)
    )
    tangential = np.atleast_1d(plain.get("tangentialdistortion", [0.0, 0.0])).astype(float).tolist()
    fields |= dict(zip(("p1", "p2"), tangential, strict=True))
    if np.size(plain.get("imagesize", [])) == 2:
        fields["height"], fields["width"] = (float(value) for value in plain["imagesize"])
    return fields


def _read_matchid(file: Path, camera: int) -> dict[str, float]:
    table = {}
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        label, separator, number = line.partition(";")
        if separator:
            table[re.sub(r"\[[^\]]*\]|\s", "", label).lower()] = float(number)
    # Files number the cameras from 0 or from 1.
    first = 0 if "cam0_fx" in table else 1
    prefix = f"cam{camera + first}_"
    names = {
        "f_x": "fx", "f_y": "fy", "skew": "fs", "c_x": "cx", "c_y": "cy",
        "k1": "kappa1", "k2": "kappa2", "k3": "kappa3", "p1": "p1", "p2": "p2",
    }  # fmt: skip
    if f"{prefix}fx" not in table:
        message = f"has no values {prefix.capitalize()}Fx"
        raise _UnrepresentableError(message)
    text = f"{file}: the origin of its pixels is not documented; the principal point may be off by 0.5 px"
    warnings.warn(text, EstimateWarning, stacklevel=5)
    return {name: table.get(prefix + key, 0.0) for name, key in names.items()}


def _read_dice(file: Path, camera: int) -> dict[str, float]:
    root = _xml_root(file)
    chosen = next(
        (each for each in root.iter("ParameterList") if each.get("name", "").upper() == f"CAMERA {camera}"), None
    )
    if chosen is None:
        message = f"has no parameter list CAMERA {camera}"
        raise _UnrepresentableError(message)
    values = {each.get("name", "").upper(): each.get("value", "") for each in chosen.findall("Parameter")}
    model = values.get("LENS_DISTORTION_MODEL", "NO_LENS_DISTORTION").upper()
    numbers = {
        key: float(value) for key, value in values.items() if re.fullmatch(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*", value)
    }
    radial = {f"k{n}": numbers.get(f"K{n}", 0.0) for n in range(1, 7)}
    if model in ("NO_LENS_DISTORTION", "NONE"):
        radial = {}
    elif model == "K1R3_K2R5_K3R7":
        # The displacement of the radius has these powers, so that the factor is 1 + k1 r² + k2 r⁴ + k3 r⁶.
        radial = {name: radial[name] for name in ("k1", "k2", "k3")}
    elif model != "OPENCV_LENS_DISTORTION" and any(radial.values()):
        message = f"lens model {model} with coefficients other than 0 cannot be represented; use the model of OpenCV"
        raise _UnrepresentableError(message)
    fields = {
        "f_x": numbers["FX"], "f_y": numbers["FY"], "skew": numbers.get("FS", 0.0), "c_x": numbers["CX"],
        "c_y": numbers["CY"], **radial,
    }  # fmt: skip
    if model == "OPENCV_LENS_DISTORTION":
        pairs = {"p1": "P1", "p2": "P2", "s1": "S1", "s2": "S2", "s3": "S3", "s4": "S4", "tau_x": "T1", "tau_y": "T2"}
        fields |= {name: numbers.get(key, 0.0) for name, key in pairs.items()}
    shape = re.findall(r"\d+", values.get("IMAGE_HEIGHT_WIDTH", ""))
    if len(shape) == 2:
        fields["height"], fields["width"] = float(shape[0]), float(shape[1])
    return fields


_READERS: dict[str, Callable[[Path, int], dict[str, float]]] = {
    "opencv": _read_opencv,
    "kalibr": _read_kalibr,
    "colmap": _read_colmap,
    "matlab": _read_matlab,
    "matchid": _read_matchid,
    "dice": _read_dice,
}


def export_calibration(
    calibration: RigCalibration, path: str | PathLike[str], *,
    target: Literal["opencv", "colmap", "matchid"], pair: int | None = None, overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write the camera of a calibration for another program.

    Parameters
    ----------
    calibration
        The calibration.
    path
        File to write: YAML for ``opencv``, ``cameras.txt`` for ``colmap``, ``.caldat`` for ``matchid``.
    target
        The program.
    pair
        Index of the position that is the second camera of ``matchid``; default: the last, or the first.
    overwrite
        Replace an existing file.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ValueError
        A `CalibrationError` if the program lacks a term of the camera.
    OutputExistsError
        If the file exists and ``overwrite`` is not set.

    See Also
    --------
    import_camera : Reads files of other programs.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.camera import Camera
    >>> from scenetruth.capture.calibration import RigCalibration, export_calibration
    >>> stated = RigCalibration.from_camera(Camera(width=640, height=480, focal_length_px=5000), [-5, 0, 5])
    >>> with TemporaryDirectory() as folder:
    ...     file = export_calibration(stated, f"{folder}/cameras.txt", target="colmap")
    ...     print(file.read_text().split()[-12:-8])
    ['5000.0', '5000.0', '320.0', '240.0']
    """
    writers = {"opencv": _opencv_text, "colmap": _colmap_text}
    if target == "matchid":
        text = _matchid_text(calibration, pair)
    elif target in writers:
        text = writers[target](calibration.camera, _focal_y(calibration))
    else:
        message = f"must be one of {', '.join([*writers, 'matchid'])}"
        raise CalibrationError([Problem("target", message, target)])
    file = Path(path)
    with write_atomically(file, overwrite=overwrite) as partial:
        partial.write_text(text, encoding="utf-8")
    return file


def _coefficients(camera: Camera) -> dict[str, float]:
    lens = camera.distortion or Distortion()
    return dict(zip(_OPENCV_ORDER, lens.coefficients, strict=True))


def _focal_y(calibration: RigCalibration) -> float:
    """Return the focal length along y, in px."""
    return calibration.value("f") * (1.0 + calibration.value("aspect"))


def _opencv_text(camera: Camera, f_y: float) -> str:
    (c_x, c_y), f = camera.principal_point, camera.focal_px
    values = list(_coefficients(camera).values())
    matrix = ", ".join(repr(float(value)) for value in (f, 0, c_x, 0, f_y, c_y, 0, 0, 1))
    lens = ", ".join(repr(float(value)) for value in values)

    def block(name: str, rows: int, columns: int, data: str) -> str:
        return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"

    size = f"image_width: {camera.width}\nimage_height: {camera.height}\n"
    head = "%YAML:1.0\n---\n"
    return head + size + block("camera_matrix", 3, 3, matrix) + block("distortion_coefficients", len(values), 1, lens)


def _colmap_text(camera: Camera, f_y: float) -> str:
    (c_x, c_y), f = camera.principal_point, camera.focal_px
    values = [f, f_y, c_x + 0.5, c_y + 0.5, *_coefficients(camera).values()]
    row = " ".join(repr(float(value)) for value in values)
    return f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 FULL_OPENCV {camera.width} {camera.height} {row}\n"


def _matchid_text(calibration: RigCalibration, pair: int | None) -> str:
    from scipy.spatial.transform import Rotation

    camera, lens = calibration.camera, _coefficients(calibration.camera)
    if any(lens[name] for name in ("k4", "k5", "k6")):
        message = "MatchID has no terms k4 to k6; calibrate without them"
        raise CalibrationError([Problem("target", message)])
    last = len(calibration.positions_mm) - 1
    other = (last if calibration.reference != last else 0) if pair is None else pair
    if not 0 <= other <= last or (other == calibration.reference and last > 0):
        raise CalibrationError([Problem("pair", f"must be a position up to {last} other than the reference", pair)])
    view = calibration.viewpoint(other)
    # X_1 = R X_0 + T, with the angles about the fixed axes x, y, z.
    turn = view.rotation.T
    angles = Rotation.from_matrix(turn).as_euler("xyz", degrees=True)
    shift = -turn @ view.position_mm
    c_x, c_y = camera.principal_point
    single = {
        "Fx [pixels]": camera.focal_px, "Fy [pixels]": _focal_y(calibration), "Fs [pixels]": 0.0, "Kappa 1": lens["k1"],
        "Kappa 2": lens["k2"], "Kappa 3": lens["k3"], "P1": lens["p1"], "P2": lens["p2"], "Cx [pixels]": c_x,
        "Cy [pixels]": c_y,
    }  # fmt: skip
    lines = [f"Cam{number}_{name};{value!r}" for number in (0, 1) for name, value in single.items()]
    lines += [f"T{axis} [mm];{float(value)!r}" for axis, value in zip("xyz", shift, strict=True)]
    lines += [f"{name} [deg];{float(value)!r}" for name, value in zip(("Theta", "Phi", "Psi"), angles, strict=True)]
    return "\n".join(lines) + "\n"
