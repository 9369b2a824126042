"""Files that models are made from, and those that are shipped with the package."""

from scenetruth.files.fields import InputFile, SceneFile, context_of, input_files, size_of_file

__all__ = ["InputFile", "SceneFile", "context_of", "input_files", "size_of_file"]
