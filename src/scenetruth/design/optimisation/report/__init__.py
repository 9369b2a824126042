"""The report of a design: scale drawings, scene files, charts and tables."""
