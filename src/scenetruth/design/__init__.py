"""Design of experiments: attainable precision, sources of uncertainty, and better rigs and patterns."""

from scenetruth.design.prediction import PredictedValue, Prediction, PredictionInputs, predict

# Not lazily: rooms are called like their functions, and an import of what is in a room would put it in their place.
__all__ = ["PredictedValue", "Prediction", "PredictionInputs", "predict"]
