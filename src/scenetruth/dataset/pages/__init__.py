"""Pages about recipes and data sets: words, charts, contact sheets, and one style for all."""
