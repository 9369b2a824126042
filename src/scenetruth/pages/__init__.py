"""What pages have in common: how they are put together, tables that sort, charts, and their style."""
