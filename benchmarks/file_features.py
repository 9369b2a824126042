"""Read a small file of each feature of mesh files and pictures, and print what was read or why it was rejected.

Areas, numbers of polygons and radiances are compared with values by hand; see `tests.helpers.file_features`.
Usage: python -m benchmarks.file_features [--write docs/results/mesh_files.md]
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path

from tests.helpers.file_features import FileFeature, Outcome, try_feature
from tests.helpers.gltf_features import GLTF_FEATURES
from tests.helpers.picture_features import PICTURE_FEATURES
from tests.helpers.polygon_features import POLYGON_FEATURES

FEATURES: tuple[FileFeature, ...] = (*POLYGON_FEATURES, *GLTF_FEATURES, *PICTURE_FEATURES)
BEGIN, END = "<!-- features: begin -->", "<!-- features: end -->"


def row(feature: FileFeature, outcome: Outcome) -> str:
    """Return a row of the table."""
    reason = " ".join(outcome.reason.split()).replace("|", "\\|")
    if outcome.wrong:
        result, detail = "**wrong**", "; ".join(outcome.wrong)
    elif feature.rejected is None:
        result, detail = "read", outcome.figures
    elif feature.of_colours:
        result, detail = "shape read, colours rejected", f"{outcome.figures}; {reason}"
    else:
        result, detail = "rejected", reason
    return f"| {feature.name} | {result} | {detail} | {feature.occurs} |"


def tables() -> tuple[str, int]:
    """Return a table for each format in Markdown, and the number of features that are wrong."""
    lines: list[str] = []
    counts: dict[str, Counter[str]] = {}
    rows: dict[str, list[str]] = {}
    wrong = 0
    for feature in FEATURES:
        outcome = try_feature(feature)
        wrong += bool(outcome.wrong)
        counts.setdefault(feature.form, Counter())["rejected" if feature.rejected else "read"] += 1
        rows.setdefault(feature.form, []).append(row(feature, outcome))
    lines += ["| format | features | read | rejected |", "|---|---|---|---|"]
    for form, count in counts.items():
        lines.append(f"| {form} | {count.total()} | {count['read']} | {count['rejected']} |")
    total = sum(counts.values(), Counter[str]())
    lines.append(f"| all | {total.total()} | {total['read']} | {total['rejected']} |")
    for form, found in rows.items():
        lines += [
            "",
            f"## {form}",
            "",
            "| feature | result | value or reason | occurs in |",
            "|---|---|---|---|",
            *found,
        ]
    return "\n".join(lines), wrong


def main() -> int:
    """Print or write the tables; return 1 if a feature is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="page whose tables are replaced")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    text, wrong = tables()
    if given.write is None:
        print(text)
    else:
        page = given.write.read_text(encoding="utf-8")
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        given.write.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
