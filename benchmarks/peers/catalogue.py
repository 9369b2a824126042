"""The peers: which program runs each, in which environment, on how many images."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["HERE", "PEERS", "Peer", "command_of", "python_of", "requirements_of", "words_of"]

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Peer:
    """A program of others.

    Parameters
    ----------
    environment
        Name of its environment, and of its file in ``requirements``.
    program
        Name of the script in ``programs``.
    gives
        What its results hold.
    options
        What it is told besides.
    cameras
        How many cameras it needs.
    """

    environment: str
    program: str
    gives: tuple[str, ...]
    options: tuple[str, ...] = ()
    cameras: int = 1


PEERS = {
    "pyvale": Peer("pyvale", "run_pyvale", ("flow",)),
    "pyvale_stereo": Peer("pyvale", "run_pyvale", ("depth", "velocity"), ("--mode", "stereo"), 2),
    "al_dic_3d": Peer("al_dic_3d", "run_al_dic_3d", ("depth", "velocity"), (), 2),
    "sun_dic": Peer("sun_dic", "run_sun_dic", ("flow",)),
    "pyxel": Peer("pyxel_dic", "run_pyxel", ("flow",)),
    "mudic": Peer("mudic", "run_mudic", ("flow",)),
}
"""By the names that they have in tables; their methods are called so too."""


def python_of(folder: Path, environment: str) -> Path:
    """Return the Python of an environment below a folder."""
    return folder.absolute() / "env" / environment / "bin" / "python"


def requirements_of(environment: str) -> tuple[str, str]:
    """Return name and version of the program of an environment, and the text of all its requirements."""
    text = (HERE / "requirements" / f"{environment}.txt").read_text(encoding="utf-8")
    wanted = environment.replace("_", "-").lower()
    for line in text.splitlines():
        name, _, number = line.partition("==")
        if name.lower().replace("_", "-") == wanted:
            return f"{name} {number}", text
    raise LookupError(f"{environment}: its requirements do not name it")


def words_of(folder: Path, name: str, options: Sequence[str] = ()) -> list[str]:
    """Return the command of a peer as words, without the folders of recording and output."""
    peer = PEERS[name]
    return [
        str(python_of(folder, peer.environment)),
        str(HERE / "programs" / f"{peer.program}.py"),
        *peer.options,
        *options,
    ]


def command_of(folder: Path, name: str, options: Sequence[str] = ()) -> str:
    """Return the command of a peer, with places for the folders of recording and output."""
    return shlex.join(words_of(folder, name, options)) + " {recording} {output}"
