"""Tells of machines that would make other samples than a data set has, or none."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version

from scenetruth.errors import BackendUnavailableError, MachineError, Problem
from scenetruth.provenance import own_release

__all__ = ["refuse_other_versions", "unfit_to_render", "versions_here"]

_PACKAGES = ("numpy", "scipy")


def versions_here() -> dict[str, str]:
    """Return the versions on which the bytes of samples depend."""
    others = {one: version(one) for one in _PACKAGES}
    return {"python": platform.python_version(), "scenetruth": own_release(), **others}


def refuse_other_versions(versions: Mapping[str, str]) -> None:
    """Refuse to make samples with other versions than a data set was begun with.

    Raises
    ------
    MachineError
        If so; names this machine.
    """
    here = versions_here()
    problems = [
        Problem("workers", f"{platform.node()} has {name} {here.get(name)}, and the data set was begun with {one}")
        for name, one in versions.items()
        if here.get(name) != one
    ]
    if problems:
        raise MachineError(problems)


def unfit_to_render(error: BackendUnavailableError) -> MachineError:
    """Return what to tell of a machine that cannot render a data set; nothing is wrong with its samples."""
    message = (
        f"{platform.node()} cannot make samples of this data set, whose backend was found out when it began: {error}; "
        "mend that or take this machine out, and go on with the same command"
    )
    return MachineError([Problem("workers", message)])
