"""Star 5 of the DIC Challenge 2.0 by all methods and programs: ``python -m benchmarks.dic_challenge [NAME...]``.

Rows of displacements are kept in FOLDER/rows, one file for each setting and pair of images; those that are there are
reused, so that a run that is cut short resumes. The tables ``dic_challenge_*.csv`` are made of the rows that are there.
Environments of the programs: ``python -m benchmarks.peers.setup``. The images come with pyvale; those of star 6, the
strain, are made of them and rendered. They are cut to the 81 rows around the centre row, which is all that is
evaluated.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import scenetruth as st
from benchmarks.dic_challenge.images import (
    BAND_PX,
    PAIRS,
    STRAIN,
    band_of,
    given_pair,
    images_at_rest,
    recording_of,
    rendered_pair,
    strain_field,
    strain_pair,
)
from benchmarks.dic_challenge.methods import (
    PROGRAM,
    SETTINGS,
    Setting,
    displacement,
    displacement_map,
    rows_of_program,
    strain_row,
)
from benchmarks.dic_challenge.rules import AMPLITUDE_PX, PUBLISHED, WIDTH_PX, evaluate, mean_of_lowest, periods_px
from benchmarks.dic_challenge.rules import STRAIN as STRAIN_AMPLITUDE
from benchmarks.jobs import heading, line
from benchmarks.peers.catalogue import python_of
from benchmarks.peers.setup import FOLDER as PEERS_FOLDER
from scenetruth.output import write_atomically

FOLDER = Path("outputs/results/dic_challenge")
SOURCES = ("given", "rendered")
STRAIN_WINDOWS_PX = (5, 11, 21)
"""Sides of the square window of strain, in pixels with a displacement each."""
BANDS_PX = ((40, 80), (80, 160), (160, 300))
"""Bands of the period over which values are averaged."""
PROGRAM_WINDOWS_PX = (5, 11)
"""Those of programs, which match each of these rows."""
_CHANGES = {"rendered": (), "rendered_strain": STRAIN}


def images_of(pair: str, folder: Path, data: Path) -> Path:
    """Return the file of both images of a pair, and make it if it is not there."""
    file = folder / "images" / f"{pair}.npy"
    if file.exists():
        return file
    file.parent.mkdir(parents=True, exist_ok=True)
    at_rest = pair.endswith("at_rest")
    if at_rest:
        source = images_of(pair.removesuffix("_at_rest"), folder, data)
        # The whole image says more about the noise than its middle.
        first = given_pair(data)[0] if pair.startswith("given") else np.load(source)[0].astype(np.float64)
        first, second = images_at_rest(first)
    elif pair == "given_strain":
        first, second = strain_pair(given_pair(data)[0])
    elif pair.startswith("rendered"):
        first, second, truth = rendered_pair(*_CHANGES[pair])
        np.save(file.with_name(f"{pair}_truth.npy"), truth)
    else:
        first, second = given_pair(data)
    with write_atomically(file, overwrite=True) as partial, partial.open("wb") as opened:
        np.save(opened, np.stack([band_of(first), band_of(second)]).astype(np.uint8))
    return file


def measure(chosen: Sequence[Setting], pairs: Sequence[str], folder: Path, data: Path, peers: Path) -> None:
    """Measure the rows that are missing."""
    (folder / "rows").mkdir(parents=True, exist_ok=True)
    missing = [(one, pair, row_file(folder, one, pair)) for one in chosen for pair in pairs]
    missing = [job for job in missing if not job[2].exists()]
    for setting, pair, file in missing:
        if setting.group == PROGRAM:
            continue
        first, second = np.load(images_of(pair, folder, data)).astype(np.float64)
        started = time.process_time()
        row = displacement(setting, first, second)
        with write_atomically(file, overwrite=True) as partial, partial.open("wb") as opened:
            np.save(opened, row)
        print(f"{file.stem}: {time.process_time() - started:.1f} s", file=sys.stderr, flush=True)
    for program in dict.fromkeys(one.method for one, _, _ in missing if one.group == PROGRAM):
        jobs = [(one, images_of(pair, folder, data), file) for one, pair, file in missing if one.method == program]
        said = rows_of_program(program, jobs, peers)
        failed = [file.stem for _, _, file in jobs if not file.exists()]
        if failed:
            print(f"{program}: nothing found for {', '.join(failed)}: {said[-1500:]}", file=sys.stderr, flush=True)


def measure_strain(chosen: Sequence[Setting], sources: Sequence[str], folder: Path, data: Path, peers: Path) -> None:
    """Measure the rows of strain that are missing, on star 6."""
    (folder / "rows").mkdir(parents=True, exist_ok=True)
    for setting in chosen:
        for pair in (each for source in sources for each in strain_pairs(source)):
            files = {window: strain_file(folder, setting, pair, window) for window in windows_of(setting)}
            if all(file.exists() for file in files.values()):
                continue
            images, started = images_of(pair, folder, data), _processor_s()
            found, said = displacements_of(setting, images, peers)
            if found is None:
                print(f"{setting.key}, {pair}: nothing found: {said[-1500:]}", file=sys.stderr, flush=True)
                continue
            for window, file in files.items():
                with write_atomically(file, overwrite=True) as partial, partial.open("wb") as opened:
                    np.save(opened, strain_row(found, window))
            print(f"{setting.key}, {pair}: {_processor_s() - started:.1f} s", file=sys.stderr, flush=True)


def displacements_of(setting: Setting, images: Path, peers: Path) -> tuple[Any, str]:
    """Return the displacements in the rows of the widest window of strain, if there are any, and what was said."""
    if setting.group != PROGRAM:
        first, second = np.load(images).astype(np.float64)
        return displacement_map(setting, first, second), ""
    with tempfile.TemporaryDirectory(prefix="star6-") as work:
        file = Path(work) / "map.npy"
        said = rows_of_program(setting.method, [(setting, images, file)], peers, max(windows_of(setting)) // 2)
        return np.load(file) if file.exists() else None, said


def windows_of(setting: Setting) -> tuple[int, ...]:
    """Return the sides of the windows of strain of a setting."""
    return PROGRAM_WINDOWS_PX if setting.group == PROGRAM else STRAIN_WINDOWS_PX


def strain_pairs(source: str) -> tuple[str, str]:
    """Return the pairs of star 6: moved and at rest."""
    return f"{source}_strain", f"{source}_at_rest"


def strain_file(folder: Path, setting: Setting, pair: str, window: int) -> Path:
    """Return the file of a row of strain."""
    return folder / "rows" / f"{setting.key}_strain_{window}_{pair}.npy"


def strain_table(folder: Path) -> list[dict[str, Any]]:
    """Return the results of strain of all settings and windows whose rows are there."""
    rows = []
    for source in SOURCES:
        for setting in SETTINGS.values():
            for window in windows_of(setting):
                files = [strain_file(folder, setting, pair, window) for pair in strain_pairs(source)]
                if not all(file.exists() for file in files):
                    continue
                moving, at_rest = (np.load(file) for file in files)
                found = evaluate(moving, at_rest, STRAIN_AMPLITUDE)
                row = {"images": source, "method": setting.code, "group": setting.group, "size_px": setting.size_px}
                rows.append({**row, "strain_window_px": window, **asdict(found), "mei_px2": found.strain_mei})
    return rows


def row_file(folder: Path, setting: Setting, pair: str) -> Path:
    """Return the file of a row."""
    return folder / "rows" / f"{setting.key}_{pair}.npy"


def table(folder: Path) -> list[dict[str, Any]]:
    """Return the results of all settings whose rows are there."""
    rows = []
    for source in SOURCES:
        for setting in SETTINGS.values():
            files = [row_file(folder, setting, pair) for pair in (source, f"{source}_at_rest")]
            if not all(file.exists() for file in files):
                continue
            moving, at_rest = (np.load(file) for file in files)
            found = evaluate(moving, at_rest)
            row = {"images": source, "method": setting.code, "group": setting.group, "size_px": setting.size_px}
            rows.append({**row, **asdict(found), "mei_px2": found.mei})
    return rows


def main() -> None:
    """Measure what is missing, write the table, and print one value per method beside the published values."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only settings whose names contain one of these")
    parser.add_argument("--folder", type=Path, default=FOLDER, help=f"results ({FOLDER})")
    parser.add_argument("--peers", type=Path, default=PEERS_FOLDER, help=f"environments ({PEERS_FOLDER})")
    parser.add_argument("--data", type=Path, help="folder of the challenge's images; default: that of pyvale")
    parser.add_argument("--pair", action="append", choices=PAIRS, help="only these images; repeatable")
    parser.add_argument("--table", action="store_true", help="measure nothing: make the table of what is there")
    parser.add_argument("--docs", type=Path, default=Path("docs/results"), help="tables go into data (docs/results)")
    parser.add_argument("--strain", action="store_true", help="measure the strain of star 6 instead")
    parser.add_argument(
        "--field", action="store_true", help="compare with the analytic field instead; also of --strain"
    )
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.field and given.strain:
        print(heading(("strain of", *(f"{low} to {high} px" for low, high in BANDS_PX))))
        for cells in strain_field_rows(given.folder):
            print(line(cells))
        return
    if given.field:
        print(heading(("images", "periods, px", "measured over analytic", "rms of the rest, px", "same at rest, px")))
        for cells in field_rows(given.folder, given.data or data_of_pyvale(given.peers)):
            print(line(cells))
        return
    if not given.table:
        chosen = [one for key, one in SETTINGS.items() if not given.names or any(part in key for part in given.names)]
        data = given.data or data_of_pyvale(given.peers)
        if given.strain:
            sources = [source for source in SOURCES if not given.pair or strain_pairs(source)[0] in given.pair]
            measure_strain(chosen, sources, given.folder, data, given.peers)
        else:
            measure(chosen, given.pair or PAIRS[:4], given.folder, data, given.peers)
    for quantity, rows in (("displacement", table(given.folder)), ("strain", strain_table(given.folder))):
        if not rows:
            continue
        ranked = summary(rows, quantity)
        for name, lines in ((quantity, rows), (f"{quantity}_ranking", ranked)):
            for place in (given.folder, given.docs / "data"):
                write_csv(place / f"dic_challenge_{name}.csv", lines)
        print(heading(list(ranked[0])))
        for cells in ranked:
            print(line(list(cells.values())))


def write_csv(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows with six digits."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(file, overwrite=True) as partial, partial.open("w", encoding="utf-8") as opened:
        writer = csv.DictWriter(opened, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _short(value) for key, value in row.items()} for row in rows)


def field_rows(folder: Path, data: Path) -> list[list[str]]:
    """Return the slope of the measured over the analytic displacement in the whole band, and what it leaves.

    The structure tensor with its smallest window loses least; the rest is noise if the images have the analytic field.
    """
    setting, cells = SETTINGS["structure_tensor_3"], []
    for source in SOURCES:
        maps = []
        for pair in (source, f"{source}_at_rest"):
            first, second = np.load(images_of(pair, folder, data)).astype(np.float64)
            found = st.estimate(recording_of(first, second), setting.method, setting.settings).sel(t=0)
            flow = found["flow"].isel(image_component=1).values
            maps.append(np.where(found["status"].values == 2, flow, np.nan))
        rows, columns = np.indices(maps[0].shape)
        periods = periods_px(columns.astype(np.float64))
        exact = AMPLITUDE_PX * np.cos(2 * np.pi * (rows - BAND_PX) / periods)
        for low, high in BANDS_PX:
            inside = (periods >= low) & (periods < high) & np.isfinite(maps[0]) & np.isfinite(maps[1])
            slope = float(np.sum(maps[0][inside] * exact[inside]) / np.sum(exact[inside] ** 2))
            rest = (maps[0] - slope * exact)[inside].std()
            cells.append([source, f"{low} to {high}", f"{slope:.3f}", f"{rest:.4f}", f"{maps[1][inside].std():.4f}"])
    return cells


def strain_field_rows(folder: Path, window: int = 11) -> list[list[str]]:
    """Return the mean strain over 5 % by band of the period: of displacement fields, and of images that have them.

    The displacements are those of the analytic field and of the truth of the rendered images, in the same window of
    strain. Standard errors of measured values are those of means over 60 columns, several times a window.
    """
    periods = periods_px(np.arange(WIDTH_PX, dtype=np.float64))
    half = window // 2
    around = np.repeat(np.arange(-half, half + 1, dtype=np.float64)[:, None], WIDTH_PX, axis=1)
    rendered = band_of(np.load(folder / "images" / "rendered_strain_truth.npy"), half)
    fields = {
        "displacements, analytic": strain_row(strain_field(around, np.broadcast_to(periods, around.shape)), window),
        "displacements, truth of rendered images": strain_row(rendered, window),
    }
    for key in ("structure_tensor_4", "refined_4", "refined_6"):
        for source in SOURCES:
            row = np.load(strain_file(folder, SETTINGS[key], strain_pairs(source)[0], window))
            fields[f"{SETTINGS[key].code}, {SETTINGS[key].size_px:g} px, {source} images"] = row
    cells = []
    for name, row in fields.items():
        ratios = []
        for low, high in BANDS_PX:
            found = row[(periods >= low) & (periods < high) & np.isfinite(row)] / STRAIN_AMPLITUDE
            means = [part.mean() for part in np.array_split(found, found.size // 60)]
            error = np.std(means, ddof=1) / np.sqrt(len(means))
            ratios.append(f"{found.mean():.4f}" if name.startswith("disp") else f"{found.mean():.3f} ± {error:.3f}")
        cells.append([name, *ratios])
    return cells


def summary(rows: Sequence[dict[str, Any]], quantity: str) -> list[dict[str, str]]:
    """Return a line per source and method among the published values, those with the lowest MEI first."""
    count, *values = PUBLISHED[quantity]
    source = SOURCES[0]
    ends = zip(("best", "median", "worst"), values, strict=True)
    lines = [(source, f"published, {name} of {count}", "", value, "", "", "") for name, value in ends]
    for images, code in dict.fromkeys((row["images"], row["method"]) for row in rows):
        own = [row for row in rows if (row["images"], row["method"]) == (images, code)]
        with_mei = sorted((row for row in own if row["mei_px2"] > 0), key=lambda row: row["mei_px2"])  # none of NaN
        found = [row["mei_px2"] for row in with_mei]
        periods = [row["first_px"] for row in own if np.isfinite(row["first_px"])]
        reach = " to ".join(dict.fromkeys(f"{end:.0f}" for end in (min(periods), max(periods)))) if periods else ""
        scatter = [row["scatter_ratio"] for row in with_mei[:3]]
        lowest = f"{min(found):.3g}" if found else ""
        ratio = f"{np.mean(scatter):.1f}" if scatter else ""
        lines.append((images, code, str(len(own)), mean_of_lowest(found), lowest, reach, ratio))
    lines.sort(key=lambda each: (SOURCES.index(each[0]), not np.isfinite(each[3]), each[3], each[1]))
    return [
        {
            "images": images,
            "method": code,
            "settings": settings,
            "MEI, px²": f"{mean:.3g}" if np.isfinite(mean) else "",
            "lowest": lowest,
            "periods, px": reach,
            "scatter, moved / at rest": scatter,
        }
        for images, code, settings, mean, lowest, reach, scatter in lines
    ]


def data_of_pyvale(peers: Path) -> Path:
    """Return the folder of the challenge's images in the environment of pyvale."""
    found = sorted(python_of(peers, "pyvale").parents[1].glob("lib/python*/site-packages/pyvale/data/dic/challenge"))
    if not found:
        raise SystemExit("the images come with pyvale: run python -m benchmarks.peers.setup pyvale, or give --data")
    return found[0]


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value


if __name__ == "__main__":
    main()
