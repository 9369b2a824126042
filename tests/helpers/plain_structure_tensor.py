"""A plain NumPy and SciPy reading of the method, image by image in float64, beside which the kernels are held."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor import DERIVATIVE, DERIVATIVE_MOMENT, SMOOTHING, gaussian_window
from scenetruth.schema import image_to_grey

Array = NDArray[np.float64]


def convolve(image: Array, kernel: Array, axis: int) -> Array:
    filtered: Array = correlate1d(image, kernel[::-1], axis=axis, mode="nearest")
    return filtered


def derivatives(grey: Array, shift: int) -> Array:
    """Return g_x, g_y, g_s, g_t and the correction of the divergence term; from (5, t, y, x) to (5, t - 4, y, x)."""
    tilt = shift * np.arange(-2, 3) * SMOOTHING
    parts = {}
    for name, kernels in {
        "x": (SMOOTHING, SMOOTHING, SMOOTHING, DERIVATIVE),
        "y": (SMOOTHING, SMOOTHING, DERIVATIVE, SMOOTHING),
        "s": (DERIVATIVE, SMOOTHING, SMOOTHING, SMOOTHING),
        "t": (SMOOTHING, DERIVATIVE, SMOOTHING, SMOOTHING),
        "mx": (SMOOTHING, SMOOTHING, SMOOTHING, DERIVATIVE_MOMENT),
        "my": (SMOOTHING, SMOOTHING, DERIVATIVE_MOMENT, SMOOTHING),
        "0": (SMOOTHING, SMOOTHING, SMOOTHING, SMOOTHING),
        "sx": (tilt, SMOOTHING, SMOOTHING, DERIVATIVE),
    }.items():
        filtered = grey
        for axis, kernel in enumerate(kernels):
            filtered = convolve(filtered, kernel, axis)
        parts[name] = filtered[2, 2:-2]
    correction = parts["mx"] + parts["my"] - 2 * parts["0"] + parts["sx"]
    return np.stack([parts["x"], parts["y"], parts["s"], parts["t"], correction])


def structure_tensor(gradients: Array, settings: StructureTensorSettings) -> Array:
    """Sum up J = Σ w d dᵀ over the window; from (5, m, y, x) to (y, x, 5, 5)."""
    over_t = gaussian_window(settings.window_sigma_frames, settings.window_taps_frames)
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    local = np.arange(len(window)) - len(window) // 2
    x, y, s, t, e = range(5)

    def weigh(a: int, b: int, order_x: int = 0, order_y: int = 0) -> Array:
        summed = np.tensordot(over_t, gradients[a] * gradients[b], 1)
        rows = correlate1d(summed, window * local**order_x, axis=1, mode="constant")
        both: Array = correlate1d(rows, window * local**order_y, axis=0, mode="constant")
        return both

    use_e = float(settings.divergence == "consistent")
    tensor = np.empty((*gradients.shape[2:], 5, 5))
    for i, a in ((0, x), (1, y), (3, s), (4, t)):
        for j, b in ((0, x), (1, y), (3, s), (4, t)):
            tensor[..., i, j] = weigh(a, b)
        tensor[..., i, 2] = tensor[..., 2, i] = weigh(a, x, 1, 0) + weigh(a, y, 0, 1) + use_e * weigh(a, e)
    tensor[..., 2, 2] = weigh(x, x, 2, 0) + 2 * weigh(x, y, 1, 1) + weigh(y, y, 0, 2)
    tensor[..., 2, 2] += use_e * (2 * weigh(x, e, 1, 0) + 2 * weigh(y, e, 0, 1) + weigh(e, e))
    return tensor


def null_space_solutions(vectors: Array, rank: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return p_s (dt = 0, ds = 1) and p_t (ds = 0, dt = 1) of least norm in the null space, by the pseudoinverse."""
    null = vectors * (np.arange(5) >= rank[..., None])[..., None, :]
    inverse = np.linalg.pinv(null[..., 3:, :])
    solutions = null @ inverse
    return solutions[..., 0], solutions[..., 1]


def estimate_plain(recording: xr.Dataset, settings: StructureTensorSettings) -> dict[str, Array]:
    """Estimate the only frame of a recording of 5 cameras, registered by ``settings.working_point_px``.

    Returns disparity, flow, depth, velocity, eigenvalues and how many of these are above τ, for the pixels that filters
    and window reach.
    """
    shift = settings.working_point_px
    assert isinstance(shift, int)
    width = recording.sizes["x"]
    first, last = 2 * abs(shift), width - 2 * abs(shift)
    grey = np.stack(
        [
            image[..., first - s * shift : last - s * shift]
            for s, image in zip(range(-2, 3), image_to_grey(recording).astype(np.float64), strict=True)
        ]
    )
    reach = 2 + settings.window_taps_px // 2
    tensor = structure_tensor(derivatives(grey, shift), settings)[reach:-reach, reach:-reach]
    values, vectors = np.linalg.eigh(tensor)
    values, vectors = values[..., ::-1], vectors[..., ::-1]
    above = (values > settings.tau).sum(axis=-1)
    p_s, p_t = null_space_solutions(vectors, np.minimum(above, 3))
    focal, (c_x, c_y) = recording.attrs["focal_length_px"], recording.attrs["principal_point_px"]
    x0 = np.arange(first + reach, last - reach) - c_x
    y0 = np.arange(reach, recording.sizes["y"] - reach)[:, None] - c_y
    disparity = shift - p_s[..., 0]
    depth = focal * recording.attrs["baseline_mm"] / disparity
    u_z = p_t[..., 2]
    u_x, u_y = p_t[..., 0] - x0 * u_z, p_t[..., 1] - y0 * u_z
    return {
        "disparity": disparity,
        "flow": np.moveaxis(p_t[..., :2], -1, 0),
        "depth": depth,
        "velocity": np.stack([u_x * depth / focal, u_y * depth / focal, -u_z * depth]),
        "eigenvalues": np.moveaxis(values, -1, 0),
        "above": above,
    }
