"""The two folders between us and programs of any language: a recording, and the results that are made of it."""

from scenetruth.estimators.external.exchange.keys import recording_key
from scenetruth.estimators.external.exchange.reading import read_results
from scenetruth.estimators.external.exchange.writing import write_recording

__all__ = ["read_results", "recording_key", "write_recording"]
