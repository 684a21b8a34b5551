"""The journal of decisions, kept for years.

- `journal`: its entries and files.
- `log`: the writer.
- `evidence`: the report that is made from the journal.
"""
