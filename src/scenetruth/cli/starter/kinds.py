"""The scenes to start from that need no file: a cube and a leaf."""

from __future__ import annotations

import json

from scenetruth.cli.starter.text import Start

__all__ = ["cube", "image_block", "leaf"]

_CUBE = """
- name: cube
  # A box about its own origin, X x Y x Z. Others: plane, sphere, cylinder, torus, relief, leaf, file, ...
  mesh: {{kind: box, size_mm: [49, 49, 49]}}
  # Turned about fixed axes one after the other (degrees, X towards Y about Z), then moved: position of its origin.
  pose:
    position_mm: [0, 0, 692.56]
    rotations:
      - {{axis: [0, 1, 0], angle_deg: 45}}
      - {{axis: [1, 0, 0], angle_deg: 20}}
  # {texture_note}
  texture: {texture}
  # Constant velocity in mm per frame, along X, Y, Z: this one comes nearer. Others: rotation, waves, splines, ...
  motion:
    - {{kind: velocity, velocity_mm_per_frame: [0, 0, -1]}}
"""

_LEAF = """
- name: leaf
  # A leaf in the plane Z = 0, its petiole at the origin, its tip along +X; bent and folded out of that plane, degrees.
  mesh:
    kind: leaf
    outline: palmate
    lobes: 7
    lobe_cut: 0.5
    length_mm: 57
    width_mm: 89
    petiole: {length_mm: 30, diameter_mm: 2.4}
    bend_along_deg: -25
    bend_across_deg: -35
    fold_deg: 20
    resolution_mm: 0.8
  # Veins and mottling, as a green leaf has them in one channel of a camera: red, green or nir.
  texture: {kind: leaf, channel: green}
  pose:
    position_mm: [2, 13.5, 600]
    rotations:
      - {axis: [0, 1, 0], angle_deg: 10}
      - {axis: [0, 0, 1], angle_deg: -100}
  # Growth of the area per hour: 0.03 are 3 %/h. At the base one and a half times as much as in the middle, at the tip
  # half as much: from X = base_mm to X = tip_mm.
  deformation:
    - {kind: growth, rate_per_hour: 0.03, base_to_tip: [1.5, 0.5], base_mm: -25, tip_mm: 57}
    # And it rises by 0.2 degrees per frame, about the end of its petiole.
    - {kind: hinge, axis: [0, 1, 0], point_mm: [-30, 0, 0], angle_deg: {kind: linear, rate_per_frame: 0.2}}
- name: soil
  mesh: {kind: plane, size_mm: [200, 160]}
  pose: {position_mm: [0, 0, 640]}
  texture: {kind: noise, wavelength_mm: [0.8, 6.0], mean: 0.12, rms_contrast: 0.3}
"""

_LIGHT = """
# The light: as much from everywhere, and lamps; a directional one shines along its direction. Without this block, what
# textures say is what the camera sees.
lighting:
  ambient: 0.25
  lights:
    - {kind: directional, direction: [-0.6, 0.45, 0.65], irradiance: 0.85}
"""


def image_block(file: str) -> str:
    """Return the texture that lays an image file on a mesh, in YAML."""
    return f"{{kind: image, file: {json.dumps(file)}, encoding: srgb}}"


def cube(image: str = "") -> Start:
    """Return a cube that comes towards the camera, with noise on it or an image.

    Parameters
    ----------
    image
        Path of an image file, as seen from the scene file; empty for noise.
    """
    noise = "{kind: noise, wavelength_mm: [0.8, 4.0], mean: 0.5, rms_contrast: 0.25}"
    told = "Noise with waves of these lengths, here 6 to 30 px, of this mean and contrast (standard deviation / mean)."
    if image:
        told = "An image, laid on each face; its grey values are sRGB, or linear."
    return Start(
        summary="A textured cube that comes towards the camera",
        first=(
            "objects: the shape, where it stands and how it moves; what is seen on it",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "sensor.noise_std: that of your camera",
        ),
        objects=_CUBE.format(texture=image_block(image) if image else noise, texture_note=told),
        focal_length_px=5016,
        focal_note="84 x 63 mm are seen at 660 mm",
        baseline_mm=5,
        baseline_note="38 px of disparity from image to image, at 660 mm",
    )


def leaf() -> Start:
    """Return a growing leaf in front of soil, one frame a minute."""
    return Start(
        summary="A growing leaf that rises, one frame a minute",
        first=(
            "objects.0.mesh: the form of the leaf; objects.0.deformation: how fast it grows",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "frames.frame_interval_s: how often you take images; sensor.noise_std: that of your camera",
        ),
        objects=_LEAF,
        focal_length_px=3200,
        focal_note="120 x 90 mm are seen at 600 mm",
        baseline_mm=5,
        baseline_note="27 px of disparity from image to image, at 600 mm",
        frame_interval_s=60,
        blocks=_LIGHT,
        sensor="bit_depth: 12\nnoise_std: 0.002",
        estimate="# Sees slow growth, and takes a minute or two; structure_tensor takes a second, and does not.\n"
        "method: refined",
    )
