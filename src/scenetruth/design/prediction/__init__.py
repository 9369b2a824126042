"""Predicted precision of depth, motion and growth from the images of a scene."""

from scenetruth.design.prediction.prediction_result import PredictedValue, Prediction, PredictionInputs
from scenetruth.design.prediction.predictor import predict, recommend

__all__ = ["PredictedValue", "Prediction", "PredictionInputs", "predict", "recommend"]
