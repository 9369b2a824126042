"""Predicted precision of depth, motion and growth from the images of a scene."""

from scenetruth.design.prediction.camera_response import (
    compute_blur_px,
    compute_derivative_response,
    compute_grey_levels,
    compute_irradiance,
    compute_transfer,
)
from scenetruth.design.prediction.method_models import all_method_models
from scenetruth.design.prediction.prediction_result import TITLES, UNITS, PredictedValue, Prediction, PredictionInputs
from scenetruth.design.prediction.predictor import predict, predict_quickly, recommend
from scenetruth.design.prediction.region_statistics import compute_spread, weighted_median
from scenetruth.design.prediction.surface_light import HighlightWindows, SurfaceLight, TextureStatistics
from scenetruth.design.prediction.surface_samples import SurfaceSamples, label_patches, rasterise, sample_surface
from scenetruth.design.prediction.texture_information import compute_flow
from scenetruth.design.prediction.texture_spectra import (
    SpectralComponents,
    analytic_spectra,
    compute_ring_spectrum,
    measure_spectrum,
)

__all__ = [
    "TITLES", "UNITS", "HighlightWindows", "PredictedValue", "Prediction", "PredictionInputs", "SpectralComponents",
    "SurfaceLight", "SurfaceSamples", "TextureStatistics", "all_method_models", "analytic_spectra", "compute_blur_px",
    "compute_derivative_response", "compute_flow", "compute_grey_levels", "compute_irradiance",
    "compute_ring_spectrum", "compute_spread", "compute_transfer", "label_patches", "measure_spectrum", "predict",
    "predict_quickly", "rasterise", "recommend", "sample_surface", "weighted_median",
]  # fmt: skip
