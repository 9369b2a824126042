"""Data sets read: a sequence of samples, whose images and maps are read when they are used."""

from scenetruth.dataset.reading.sample import Sample
from scenetruth.dataset.reading.sequence import SceneDataset, open_dataset

__all__ = ["Sample", "SceneDataset", "open_dataset"]
