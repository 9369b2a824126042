"""Time of small images with ground truth: what remains of it without pixels.

    NUMBA_NUM_THREADS=1 python -m benchmarks.small_images

Processor milliseconds per image of five cameras and three frames, by one thread, in a second run in the same process.
With a fixed view, smaller images have larger pixels, which contain more texels and faces; with a fixed focal length,
they show less of the scene.
"""

from __future__ import annotations

import time
import warnings

import numpy as np

import scenetruth as st

SCENES = {"cube": 5016.0, "leaf": 3200.0, "rosette": 2900.0}
SIZES = (40, 80, 160, 320)
FRAMES, WIDTH = 3, 640


def milliseconds(name: str, width: int, focal_length_px: float) -> float:
    """Return the processor time of an image."""
    given = [f"camera.width={width}", f"camera.height={width * 3 // 4}", f"camera.focal_length_px={focal_length_px}"]
    given.append(f"frames.count={FRAMES}")
    st.simulate(name, overrides=given)
    start = time.process_time()
    images = st.simulate(name, overrides=given).recording.image
    return float((time.process_time() - start) / (images.sizes["s"] * images.sizes["t"]) * 1e3)


def main() -> None:
    """Print the times, and their linear function of the number of pixels at none."""
    warnings.simplefilter("ignore", st.errors.SceneWarning)
    pixels = [width * (width * 3 // 4) for width in SIZES]
    print("| scene | fixed |", *(f"{width} px |" for width in SIZES), "without pixels |")
    for name, focal in SCENES.items():
        for fixed in ("view", "focal length"):
            times = [milliseconds(name, width, focal * width / WIDTH if fixed == "view" else focal) for width in SIZES]
            _, constant = np.polyfit(pixels, times, 1)
            print(f"| {name} | {fixed} |", *(f"{each:.1f} |" for each in times), f"{constant:.1f} |", flush=True)


if __name__ == "__main__":
    main()
