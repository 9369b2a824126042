"""Files that models are made from, and those that are shipped with the package."""

from scenetruth.files.fields import InputFile, context_of, input_files, size_of_file

__all__ = ["InputFile", "context_of", "input_files", "size_of_file"]
