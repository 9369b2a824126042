"""Compiled code finds a place wherever scenetruth is started, and its making is told."""

from __future__ import annotations

import gc
import importlib
import os
import pkgutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite.binding import ffi  # type: ignore[import-untyped]
from numba.core import codegen, event
from numba.core.base import BaseContext
from numba.extending import overload
from numpy.typing import NDArray

import scenetruth as st
from scenetruth import compilation
from scenetruth.compilation import announced_compilation, check_environment, keep_compiled_code, thread_count
from scenetruth.kernels import kernel, subkernel


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine where neither the package nor the user's cache can be written to, but a temporary folder can."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nothing")
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    package, access = Path(compilation.__file__).parent, os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != package and access(path, mode))
    return tmp_path


def test_a_private_folder_takes_compiled_code(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Restored when the test ends.
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    del os.environ["NUMBA_CACHE_DIR"]
    keep_compiled_code()
    folder = nowhere / f"scenetruth-{os.getuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR == str(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_a_folder_that_others_may_write_to_is_not_taken(nowhere: Path) -> None:
    (nowhere / f"scenetruth-{os.getuid()}").mkdir(mode=0o777)
    (nowhere / f"scenetruth-{os.getuid()}").chmod(0o777)
    keep_compiled_code()
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_what_the_user_has_set_stays(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/my/own")
    keep_compiled_code()
    assert os.environ["NUMBA_CACHE_DIR"] == "/my/own"


@pytest.mark.parametrize("threads", ["0", "-1", "many", "", "²"])
def test_impossible_settings_are_told_together(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    monkeypatch.setenv("NUMBA_THREADING_LAYER", "nonsense")
    with pytest.raises(st.MachineError) as caught:
        check_environment()
    assert [problem.path for problem in caught.value.problems] == ["NUMBA_NUM_THREADS", "NUMBA_THREADING_LAYER"]


def test_every_compilation_is_announced() -> None:
    @numba.njit
    def doubled(x: float) -> float:
        return 2 * x

    told: list[tuple[str, int]] = []
    with announced_compilation(lambda name, before: told.append((name, before))):
        doubled(1.0)
        doubled(2.0)
        doubled(3)
    doubled(1 + 2j)
    assert told == [("doubled", 0), ("doubled", 1)]


def test_the_number_of_threads_is_that_of_numba() -> None:
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert thread_count() == 1
    finally:
        numba.set_num_threads(before)
    assert thread_count() == before


@pytest.mark.parametrize("told", ["1", "2"])
def test_a_store_is_packed_by_no_more_threads_than_allowed(told: str, tmp_path: Path) -> None:
    code = (
        "import sys, threading\n"
        "started, begin = [], threading.Thread.start\n"
        "threading.Thread.start = lambda self: (started.append(self.name), begin(self))[1]\n"
        "from scenetruth.compilation import thread_count\n"
        "assert thread_count() == int(sys.argv[2]) and 'numba' not in sys.modules\n"
        "import numpy as np, scenetruth as st\n"
        "images = np.zeros((2, 3, 30, 40), np.uint8)\n"
        "st.save_store(st.make_recording(images, focal_length_px=50, baseline_mm=1), sys.argv[1])\n"
        "print(*started)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "recording.zarr"), told],
        env={**os.environ, "NUMBA_NUM_THREADS": told},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ("store_" in done.stdout) == (told == "2")


def _hashed(values: NDArray[np.float64]) -> int:
    return hash(values.sum())


def test_kernels_are_loaded_without_the_declarations_of_the_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    values = np.array([3.0, 0.5])
    assert kernel()(_hashed)(values) == hash(3.5)
    monkeypatch.setattr(BaseContext, "refresh", lambda self: pytest.fail("declarations are loaded"))
    loaded = kernel()(_hashed)
    assert loaded(values) == hash(3.5)
    assert sum(loaded.stats.cache_hits.values()) == 1


def _compiled_kernels() -> Iterator[tuple[str, Any]]:
    """Give all functions compiled by numba in modules of the package, also those in dictionaries, by name."""
    for found in pkgutil.walk_packages(st.__path__, "scenetruth."):
        if "kernels" not in found.name:
            continue
        for name, value in vars(importlib.import_module(found.name)).items():
            for each in value.values() if isinstance(value, dict) else [value]:
                if hasattr(each, "py_func"):
                    yield f"{found.name}.{name}", each


def _probe(x: float) -> float:
    """Stand-in whose code is given to the compiler by the test below, while it compiles."""
    raise NotImplementedError


def test_the_garbage_collector_is_suspended_while_kernels_are_compiled() -> None:
    during = []

    @overload(_probe)
    def _given(x):  # type: ignore[no-untyped-def]  # numba compares the signatures, annotations too
        during.append(gc.isenabled())
        return lambda x: x

    @kernel(cache=False)
    def fails(x: float) -> float:
        return x.missing  # type: ignore[attr-defined,no-any-return]

    compiled = kernel(cache=False)(lambda x: _probe(x))
    before = gc.isenabled()
    try:
        for enabled, value in ((True, 1.0), (False, 1)):
            (gc.enable if enabled else gc.disable)()
            during.clear()
            assert compiled(value) == value
            assert gc.isenabled() == enabled
            with pytest.raises(numba.TypingError):
                fails(value)
            assert gc.isenabled() == enabled
            assert set(during) == {False}
    finally:
        (gc.enable if before else gc.disable)()


def test_kernels_are_no_closures_over_other_kernels() -> None:
    # Numba stores closures by the pickled values of their variables. Kernels among these differ from process to
    # process: every process would compile the closure anew and add a file to the cache.
    kernels = list(_compiled_kernels())
    assert len(kernels) > 50
    closures = [(name, cell.cell_contents) for name, each in kernels for cell in each.py_func.__closure__ or ()]
    assert closures
    assert [name for name, value in closures if hasattr(value, "py_func")] == []


def test_functions_of_kernels_are_compiled_once_for_all_constants_and_run_as_python_from_python() -> None:
    @subkernel()
    def power(x: float, count: int) -> float:
        total = 1.0
        for _ in range(count):
            total *= x
        return total

    @kernel(cache=False)
    def powers(x: float, count: int) -> tuple[float, float, float]:
        return power(x, 2), power(x, 3), power(x, count)

    assert powers(1.5, 4) == (1.5**2, 1.5**3, 1.5**4)
    assert len(power.signatures) == 1
    name = next(iter(power.overloads.values())).fndesc.llvm_cpython_wrapper_name
    assert name not in next(iter(power.inspect_llvm().values()))
    # What is compiled has no wrapper to be called by.
    assert power(1.5, 2) == 1.5**2


def _shifted(x: float, by: float) -> float:
    if by < 0:
        raise ValueError("only to the right")
    return float(x + np.array([by, by]).sum() / 2)


_shifted_in_kernels = subkernel()(_shifted)


def _shifted_once(x: float, by: float) -> float:
    return float(_shifted_in_kernels(x, by))


def _shifted_twice(x: float, by: float) -> float:
    return float(_shifted_in_kernels(_shifted_in_kernels(x, by), by))


def test_only_kernels_have_machine_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A version of numba in which this fails compiles as well, but takes a tenth longer.
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    made: list[str] = []
    add = codegen.JitEngine.add_module

    def note(engine: Any, module: Any) -> Any:
        made.append(module.name)
        return add(engine, module)

    monkeypatch.setattr(codegen.JitEngine, "add_module", note)
    for function, expected in ((_shifted_once, 2.5), (_shifted_twice, 4.0)):
        for _ in range(2):
            # The second time from the cache.
            compiled = kernel()(function)
            assert compiled(1.0, 1.5) == expected
            with pytest.raises(ValueError, match="only to the right"):
                compiled(1.0, -1.5)
    assert [name for name in made if "shifted" in name] == ["_shifted_once"] * 2 + ["_shifted_twice"] * 2
    assert not [name for name in made if "impl" in name]
    # Functions of others keep theirs.
    made.clear()
    part = numba.njit(no_cpython_wrapper=True)(_shifted)
    assert numba.njit(lambda x, by: part(x, by))(1.0, 1.5) == 2.5
    assert "_shifted" in made


def test_calls_of_llvm_are_not_timed() -> None:
    # A version of numba or llvmlite in which this fails compiles as well, but takes a twelfth longer.
    assert ffi.lib._lock._cblist == []
    heard = []

    class Heard(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            heard.append(event.kind)

        def on_end(self, event: Any) -> None: ...

    with event.install_listener("numba:llvm_lock", Heard()):
        assert kernel(cache=False)(lambda x: x + 1)(1) == 2
    assert heard == []


def test_kernels_divide_as_numpy_does() -> None:
    assert kernel(cache=False)(lambda x, y: x / y)(1.0, 0.0) == np.inf
