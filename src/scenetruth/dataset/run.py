"""Makes a data set: what is missing of it, by workers, with a catalogue, whatever happened before."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.dataset.catalogue.store import CatalogueWriter, catalogued, write_whole
from scenetruth.dataset.checking import refuse_recipe
from scenetruth.dataset.engine.drive import Drive
from scenetruth.dataset.engine.room import Room, patiently
from scenetruth.dataset.engine.workers import workers_of
from scenetruth.dataset.folder import DatasetFolder, claim_sample
from scenetruth.dataset.identity import Identity, begin, open_sampler, read_identity
from scenetruth.dataset.part import Part
from scenetruth.dataset.sample import Made, scene_of, try_sample
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.shelf import Shelf
from scenetruth.placing import hold, sweep_inside, write_aside
from scenetruth.plain import parse_json
from scenetruth.progress import Progress
from scenetruth.resources import Forecast, Limits, bounded_parts, demand_of, foresee, machine_at, refuse_resources

__all__ = ["Outcome", "Status", "forecast_of", "run_dataset", "status_of"]


@dataclass
class Outcome:
    """What a run has made.

    Parameters
    ----------
    folder
        The data set.
    made
        How many samples it has made.
    present
        How many of its part were there before.
    failed
        Numbers of the samples that failed.
    """

    folder: DatasetFolder
    made: int = 0
    present: int = 0
    failed: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class Status:
    """How far a data set is.

    Parameters
    ----------
    count
        Samples in all.
    done
        Samples that are there.
    failed
        Numbers of those that failed, with what went wrong.
    """

    count: int
    done: int
    failed: dict[int, str]

    @property
    def missing(self) -> int:
        """Samples that are not there."""
        return self.count - self.done


def run_dataset(
    sampler: Sampler | None,
    folder: str | Path,
    *,
    workers: int = 1,
    threads: int = 1,
    scheduler: str | None = None,
    part: Part | None = None,
    retries: int = 1,
    recycle: int = 500,
    extend: bool = False,
    limits: Limits | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Outcome:
    """Make what is missing of a data set.

    Samples appear whole, or not at all; what is there stays. It can be killed at any moment, and run again.

    Parameters
    ----------
    sampler
        The recipe with its base scenes, as `load_recipe` makes it; None to go on with the one in the folder.
    folder
        The data set.
    workers
        Processes of this machine; 0 to do all in this one.
    threads
        Threads of each.
    scheduler
        Address of a Dask scheduler, whose workers are taken instead. They must see the folder by the same path.
    part
        Which part to make, for several machines that share the folder; all if not given.
    retries
        How often a sample that failed is tried again.
    recycle
        Samples after which a process is started anew.
    extend
        Whether the data set may get more samples than it had.
    limits
        Bounds of what a sample may ask for and take; those by default if not given.
    progress
        Called with (what, done, total).
    notice
        Called with lines that a user may want to read.

    Returns
    -------
    Outcome
        How many samples were made, and which failed; why is told by their files in ``failed/``.

    Raises
    ------
    RecipeError
        If the recipe makes no samples, as far as ranges and the first draws tell; before any work.
    MachineError
        If a sample takes more than the machine has; before any work.
    MismatchError
        If the folder holds a data set of another recipe.
    OutputExistsError
        If another run makes this part.

    See Also
    --------
    load_recipe : A recipe from a file.
    open_dataset : Read a data set.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> far = {"objects.0.pose.position_mm.2": {"kind": "uniform", "low": 90, "high": 110}}
    >>> recipe = st.recipe_from_plain({"name": "walls", "base": plain, "samples": 2, "vary": far})
    >>> with TemporaryDirectory() as folder:
    ...     outcome = st.run_dataset(recipe, f"{folder}/walls", workers=0)
    ...     dataset = st.open_dataset(f"{folder}/walls")
    ...     print(outcome.made, dataset[1].truth.depth.sizes)
    2 Frozen({'t': 1, 'y': 25, 'x': 30})
    """
    places, whole = DatasetFolder(folder), part or Part()
    say = notice or (lambda _: None)
    if sampler is None:
        sampler = open_sampler(places)
        identity = read_identity(places)
    else:
        refuse_recipe(sampler)
        identity = begin(places, sampler, extend=extend)
    forecast = forecast_of(sampler, identity, limits or Limits(), places.path)
    outcome = Outcome(places)
    with hold(places.path / f"run-{whole.label}"):
        for group in places.groups_with_leftovers():
            sweep_inside(group, claim_sample)
        shelf = Shelf.of(places, sampler, identity)
        numbers = shelf.numbers(whole)
        done = shelf.present(numbers)
        outcome.present = len(done)
        writer = CatalogueWriter(places, sampler, whole.label)
        _catalogue_missing(shelf, writer, done)
        shelf.pack(numbers)
        crew = workers_of(workers, threads, scheduler)
        if dashboard := getattr(crew, "dashboard", ""):
            say(f"dashboard: {dashboard}")
        work = _Work(places, shelf, writer, outcome, len(numbers), progress, say)
        room = Room(places.path, 2 * crew.count * forecast.disk_wanted_bytes, forecast.memory_bytes)
        try:
            drive = Drive(
                crew, try_sample, (str(places.path.resolve()),), work.made, work.failed, say, room, retries, recycle
            )
            work.tell()
            drive.run(number for number in numbers if number not in done)
            crew.renew()
            patiently(writer.flush, "the catalogue", say)
        finally:
            crew.close()
            for group in places.groups_with_leftovers():
                sweep_inside(group, claim_sample)
            writer.flush_if_there_is_room()
        if len(shelf.present(range(identity.count))) == identity.count:
            patiently(lambda: write_whole(places, sampler), "the catalogue", say)
    return outcome


def forecast_of(sampler: Sampler, identity: Identity | None, limits: Limits, folder: Path) -> Forecast:
    """Return what one sample takes, and refuse more than the machine has.

    Parameters
    ----------
    sampler
        The recipe; its first sample stands for all.
    identity
        The data set, if there is one already.
    limits
        What may be taken.
    folder
        Where samples go.

    Raises
    ------
    MachineError
        If it is more than the machine has, or than is allowed.
    SceneError
        If it passes a bound.
    """
    draw = sampler.draw(0)
    scene = draw.scene() if identity is None else scene_of(sampler, identity, draw)
    truth = sampler.recipe.truth
    demand = demand_of(
        scene,
        bounded_parts(scene, limits),
        views=scene.stage.positions * scene.stage.rows if truth.views == "all" else 1,
        complete=truth.content == "complete",
        ideal=sampler.recipe.ideal,
    )
    forecast = foresee(demand, ["render"])
    refuse_resources(forecast, machine_at(folder), limits)
    return forecast


def status_of(folder: str | Path) -> Status:
    """Return how far a data set is, from what lies in its folder.

    Raises
    ------
    StoreError
        If there is none.
    """
    places = DatasetFolder(folder)
    identity = read_identity(places)
    done = Shelf.of(places, open_sampler(places), identity).present(range(identity.count))
    failed = {number: _message(places.failure(number)) for number in places.failures() if number not in done}
    return Status(identity.count, len(done), failed)


def _message(path: Path) -> str:
    try:
        found = parse_json(path.read_bytes())
        return str(found["message"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"cannot be read: {error}"


def _catalogue_missing(shelf: Shelf, writer: CatalogueWriter, done: set[int]) -> None:
    """Put samples into the catalogue whose run was killed before it did."""
    for row in shelf.rows(done - catalogued(shelf.folder)):
        writer.add(row)
    writer.flush()


@dataclass
class _Work:
    """Takes what workers have made; a sample is in the catalogue, or still to be told of, before its folder goes."""

    places: DatasetFolder
    shelf: Shelf
    writer: CatalogueWriter
    outcome: Outcome
    total: int
    progress: Progress | None
    say: Callable[[str], None]

    def made(self, found: Made) -> None:
        self.writer.add({**found.row, "seconds": found.seconds})
        self.places.failure(found.number).unlink(missing_ok=True)
        self.outcome.made += 1
        patiently(lambda: self.shelf.added(found.number), "a tar file", self.say)
        self.tell()

    def failed(self, found: Made, attempts: int) -> None:
        failure: dict[str, Any] = {**found.failure, "attempts": attempts}
        failure.setdefault("again", f"scenetruth dataset sample {self.places.recipe} {found.number} -o sample")
        patiently(lambda: self._tell_of(found.number, failure), "what went wrong", self.say)
        self.outcome.failed.append(found.number)
        lines = str(failure["message"]).splitlines()
        self.say(f"sample {found.number} failed: {lines[0] if len(lines) == 1 else ' '.join(lines[:3])}")
        self.tell()

    def _tell_of(self, number: int, failure: Mapping[str, Any]) -> None:
        self.places.failed.mkdir(exist_ok=True)
        with write_aside(self.places.failure(number), overwrite=True) as aside:
            aside.write_text(json.dumps(failure, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    def tell(self) -> None:
        if self.progress is not None:
            done = self.outcome.made + self.outcome.present + len(self.outcome.failed)
            self.progress("samples", done, self.total)
