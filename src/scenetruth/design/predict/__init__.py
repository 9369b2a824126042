"""Precision from theory: which standard deviations of depth, motion and growth the images of a scene allow."""

from scenetruth.design.predict.predicting import advise, predict
from scenetruth.design.predict.prediction import Causes, Figure, Prediction

__all__ = ["Causes", "Figure", "Prediction", "advise", "predict"]
