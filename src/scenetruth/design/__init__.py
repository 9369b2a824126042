"""The design of experiments: what precision is possible, what takes it away, and which rig does better."""

from scenetruth.design.predict import Causes, Figure, Prediction, predict

# Not lazily: rooms are called like their functions, and an import of what is in a room would put it in their place.
__all__ = ["Causes", "Figure", "Prediction", "predict"]
