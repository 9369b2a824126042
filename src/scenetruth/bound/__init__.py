"""What precision the images of a scene allow: the Cramér-Rao bound of every pixel, and closed forms of it."""

from scenetruth.bound.envelope import Envelope, envelope_of, gradient_of_texture
from scenetruth.bound.evaluate import cramer_rao

__all__ = ["Envelope", "cramer_rao", "envelope_of", "gradient_of_texture"]
