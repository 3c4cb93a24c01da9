"""The table of a recording: in memory, as a Parquet file, and while it is recorded."""
