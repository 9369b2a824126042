"""What the shell completes: names of methods and of shipped files; nothing heavy is imported for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from scenetruth.cli.shipped import Shelf

__all__ = ["files_on", "method_names"]

_METHODS = Path(__file__).resolve().parents[1] / "estimators" / "methods"
_ENTRY_POINTS = "scenetruth.estimators"


def method_names(incomplete: str) -> list[str]:
    """Return the installed methods whose names begin so, as `scenetruth methods` lists them; none is loaded."""
    import pkgutil
    from importlib import metadata

    own = [module.name for module in pkgutil.iter_modules([str(_METHODS)])]
    offered = [point.name for point in metadata.entry_points(group=_ENTRY_POINTS)]
    return _beginning(incomplete, [*own, *offered])


def files_on(shelf: Shelf) -> Callable[[str], list[str]]:
    """Return what completes the argument that takes a file, or the name of a shipped one.

    Where nothing is found, shells complete paths themselves, folders among them.
    """

    def complete(incomplete: str) -> list[str]:
        folder = Path(incomplete).parent if "/" in incomplete else Path()
        start = incomplete.rpartition("/")[0] + "/" if "/" in incomplete else ""
        try:
            here = [start + file.name for file in folder.iterdir() if file.suffix in (".yaml", ".yml")]
        except OSError:
            here = []
        return _beginning(incomplete, [*shelf.files(), *here])

    return complete


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(incomplete)})
