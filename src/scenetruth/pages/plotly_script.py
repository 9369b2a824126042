"""The script that draws the charts of pages, which sends nothing anywhere."""

from __future__ import annotations

__all__ = ["plotly_script"]

# Plotly's own default has a button that uploads the chart.
_SETTINGS = '{responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: ""}'


def plotly_script() -> str:
    """Return plotly's script, set for pages that need no network: its buttons offer no upload.

    Examples
    --------
    >>> plotly_script().rstrip().endswith('showSendToCloud: false, plotlyServerURL: ""});')
    True
    """
    from plotly.offline import get_plotlyjs

    return f"{get_plotlyjs()}\nPlotly.setPlotConfig({_SETTINGS});\n"
