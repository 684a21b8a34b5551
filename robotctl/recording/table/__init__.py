"""The messages of one topic as a table: CSV, JSON lines, Parquet, NumPy arrays."""
