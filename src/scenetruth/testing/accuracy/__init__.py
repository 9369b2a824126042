"""Assertions of how accurate an estimate is: limits by quantity, and a failure that says what to look at."""

from scenetruth.testing.accuracy.assertion import assert_accuracy
from scenetruth.testing.accuracy.limits import LimitError

__all__ = ["LimitError", "assert_accuracy"]
