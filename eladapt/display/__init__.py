"""What happened in a run, on paper and on a page: plots, charts, tables, the report."""
