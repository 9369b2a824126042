"""The page of a comparison: tables that sort, plots that answer, and the line that makes each point again."""
