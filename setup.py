"""Puts the scenes and the glossary into the package when it is built; all else stands in pyproject.toml."""

from __future__ import annotations

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

_SCENES, _SHIPPED = "scenes", "scenetruth/shipped"
_GLOSSARY = Path("docs/reference/glossary.md")


class BuildWithScenes(build_py):
    """Copies ``scenes/`` and the glossary to ``scenetruth/shipped/``; an editable installation reads it where it is."""

    def run(self) -> None:
        """Build the package, then copy the scenes and the glossary into it."""
        super().run()
        if not self.editable_mode:
            for source, target in self._copies().items():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, target)

    def get_outputs(self, include_bytecode: bool = True) -> list[str]:
        """Return what is written, as of the base class."""
        return [*super().get_outputs(include_bytecode), *map(str, self._copies().values())]

    def get_source_files(self) -> list[str]:
        """Return what it is written from, which goes into source distributions."""
        return [*super().get_source_files(), *map(str, self._copies())]

    def _copies(self) -> dict[Path, Path]:
        files = [path for path in sorted(Path(_SCENES).rglob("*")) if path.is_file()]
        files = [path for path in files if "__pycache__" not in path.parts and not path.name.startswith(".")]
        copies = {path: Path(self.build_lib, _SHIPPED, path.relative_to(_SCENES)) for path in files}
        return copies | {_GLOSSARY: Path(self.build_lib, _SHIPPED, _GLOSSARY.name)}


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildWithScenes})
