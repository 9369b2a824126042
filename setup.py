"""Puts the scenes, the glossary and the script of plotly with its licence into the package when it is built."""

from __future__ import annotations

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

_SCENES, _SHIPPED = "scenes", "scenetruth/shipped"
_GLOSSARY = Path("docs/reference/glossary.md")
_SCRIPT = "scenetruth/templates/plotly.min.js"
_LICENCE = "scenetruth/templates/plotly.LICENSE.txt"


class BuildWithCopies(build_py):
    """Copies scenes and glossary to ``scenetruth/shipped/``, plotly's script and licence to ``scenetruth/templates/``.

    An editable installation reads scenes and glossary where they are, and gets the script with its templates.
    """

    def run(self) -> None:
        """Build the package, then copy the files into it."""
        super().run()
        for source, target in self._copies().items():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)

    def get_outputs(self, include_bytecode: bool = True) -> list[str]:
        """Return what is written, as of the base class."""
        return [*super().get_outputs(include_bytecode), *map(str, self._copies().values())]

    def get_source_files(self) -> list[str]:
        """Return what it is written from, which goes into source distributions."""
        return [*super().get_source_files(), *map(str, self._documents())]

    def _copies(self) -> dict[Path, Path]:
        script = self._script()
        if self.editable_mode:
            return {script: Path("src", _SCRIPT)}
        copies = {script: Path(self.build_lib, _SCRIPT), self._licence(): Path(self.build_lib, _LICENCE)}
        return {**self._documents(), **copies}

    def _documents(self) -> dict[Path, Path]:
        files = [path for path in sorted(Path(_SCENES).rglob("*")) if path.is_file()]
        files = [path for path in files if "__pycache__" not in path.parts and not path.name.startswith(".")]
        copies = {path: Path(self.build_lib, _SHIPPED, path.relative_to(_SCENES)) for path in files}
        return copies | {_GLOSSARY: Path(self.build_lib, _SHIPPED, _GLOSSARY.name)}

    def _script(self) -> Path:
        # Importing plotly would take a second.
        from importlib.metadata import distribution

        return Path(str(distribution("plotly").locate_file("plotly/package_data/plotly.min.js")))

    def _licence(self) -> Path:
        from importlib.metadata import distribution

        plotly = distribution("plotly")
        found = [file for file in plotly.files or () if file.name.upper().startswith("LICENSE")]
        # Its licence requires that copies contain it.
        return Path(str(plotly.locate_file(found[0])))


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildWithCopies})
