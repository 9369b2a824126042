"""Second process that compiles kernels in parallel and draws figures."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from scenetruth.estimators import MethodChoice
    from scenetruth.scoring import FigureInfo

__all__ = ["FigureWorker", "open_figure_worker"]

_DIE_WITH_PARENT = 1


class FigureWorker:
    """Second process on one processor that imports modules during other work; it ends with the block or its parent."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._asked = False
        # Requests wait for the answers to earlier requests.
        self._requests = ThreadPoolExecutor(1, "figures")

    def __enter__(self) -> Self:
        with suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-m", "scenetruth.pipeline.figure_worker", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._requests.shutdown(cancel_futures=True)
            self._process.communicate()

    def compile_method(self, choice: MethodChoice, dtype: str) -> None:
        """Compile the kernels of a method in the second process; other processes read them from the cache."""
        settings = choice.settings.model_dump(mode="json")
        self._compile({"method": choice.method, "settings": settings, "dtype": dtype})

    def compile_last_of_truth(self) -> None:
        """Compile the kernels of the truth that a run needs last (`precompilation.compile_late_truth_kernels`)."""
        self._compile({})

    def wait(self) -> None:
        """Wait until the second process has compiled what it was asked to."""
        if self._asked or self._process is None or self._process.stdin is None or self._process.stdout is None:
            return
        with suppress(OSError, ValueError):
            self._process.stdin.write(json.dumps({"wait": True}) + "\n")
            self._process.stdin.flush()
            self._process.stdout.readline()

    def _compile(self, what: dict[str, Any]) -> None:
        if self._asked or self._process is None or self._process.stdin is None:
            return
        with suppress(OSError, ValueError):
            self._process.stdin.write(json.dumps({"compile": what}) + "\n")
            self._process.stdin.flush()

    def draw(self, name: str, stores: dict[str, str | None], folder: Path) -> Future[FigureInfo | None]:
        """Draw a figure after those requested earlier, unless it is cancelled before; any error may occur."""
        self._asked = True
        return self._requests.submit(self._ask, json.dumps({"name": name, "folder": str(folder), **stores}))

    def _ask(self, request: str) -> FigureInfo | None:
        if self._process is None or self._process.stdin is None or self._process.stdout is None:
            msg = "no second process"
            raise OSError(msg)
        self._process.stdin.write(request + "\n")
        self._process.stdin.flush()
        values = json.loads(self._process.stdout.readline())["figure"]
        from scenetruth.scoring import FigureInfo

        return None if values is None else FigureInfo(*values)


@contextmanager
def open_figure_worker(wanted: int | FigureWorker) -> Iterator[FigureWorker | None]:
    """Provide a second process for compilation and drawing while the block runs, or None."""
    if isinstance(wanted, FigureWorker):
        yield wanted
    elif wanted < 1:
        yield None
    else:
        with FigureWorker() as helper:
            yield helper


def _serve(requests: IO[str], answers: IO[str]) -> None:
    """Process requests to compile and draw, one per line."""
    from scenetruth.scoring import Score, plot_one
    from scenetruth.storage import open_store

    opened: dict[str, Any] = {}

    def read(path: str) -> Any:
        if path.endswith(".json"):
            return Score.from_json(Path(path).read_text(encoding="utf-8"))
        return open_store(path)

    for line in requests:
        request = json.loads(line)
        if "wait" in request:
            answers.write("\n")
            answers.flush()
            continue
        if "compile" in request:
            from scenetruth.pipeline.precompilation import compile_late_truth_kernels, compile_method

            # The same error occurs in the first process, which reports it.
            with suppress(Exception):
                if request["compile"]:
                    compile_method(**request["compile"])
                else:
                    compile_late_truth_kernels()
            continue
        parts: dict[str, Any] = {}
        for key in ("recording", "estimate", "truth", "score"):
            path = request[key]
            if path is not None and path not in opened:
                opened[path] = read(path)
            parts[key] = None if path is None else opened[path]
        figure = plot_one(request["name"], **parts, folder=request["folder"])
        values = None if figure is None else [figure.file, figure.title, figure.caption]
        answers.write(json.dumps({"figure": values}) + "\n")
        answers.flush()


def _end_with(parent: int) -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)


if __name__ == "__main__":
    _end_with(int(sys.argv[1]))
    import matplotlib.figure  # noqa: F401  # ahead of the first request

    _serve(sys.stdin, sys.stdout)
