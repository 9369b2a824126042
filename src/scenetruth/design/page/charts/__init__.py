"""Charts of a design, as plain values that plotly's JavaScript draws: the front, and what parameters do."""
