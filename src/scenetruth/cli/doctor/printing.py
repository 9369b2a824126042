"""How findings are told: a table for people, JSON for reports of faults."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict

from scenetruth.cli.doctor.finding import Finding, is_fit
from scenetruth.cli.doctor.packages import versions

__all__ = ["as_json", "print_findings"]

_STYLES = {"ok": "green", "missing": "yellow", "broken": "red"}


def print_findings(findings: Sequence[Finding]) -> None:
    """Print all findings, each with its remedy, and whether scenes can be run."""
    from rich.table import Table
    from rich.text import Text

    from scenetruth.cli.tables import console
    from scenetruth.errors import visible

    table = Table(show_header=False, box=None, pad_edge=False)
    for _ in range(3):
        table.add_column(overflow="fold")
    group = ""
    for one in findings:
        if one.group != group:
            table.add_row(Text(one.group, style="bold"), "", "")
            group = one.group
        table.add_row(
            f"  {visible(one.name, lines=False)}",
            Text(one.state, style=_STYLES[one.state]),
            visible(one.told, lines=False),
        )
        if one.remedy:
            table.add_row("", "", Text(f"-> {visible(one.remedy, lines=False)}", style=_STYLES[one.state]))
    console().print(table)
    fit = is_fit(findings)
    console().print("scenes can be run here" if fit else "scenes cannot be run here: see what is broken above")


def as_json(findings: Sequence[Finding]) -> str:
    """Return the findings and the versions of all packages as JSON."""
    told = {"fit": is_fit(findings), "findings": [asdict(one) for one in findings], "packages": versions()}
    return json.dumps(told, indent=2)
