"""Predicted precision: the standard deviations of depth, motion and growth that the images of a scene allow."""

from scenetruth.design.prediction.prediction_result import PredictedValue, Prediction, PredictionInputs
from scenetruth.design.prediction.predictor import predict, recommend

__all__ = ["PredictedValue", "Prediction", "PredictionInputs", "predict", "recommend"]
