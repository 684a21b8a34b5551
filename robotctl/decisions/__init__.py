"""The long-lived journal of decisions: who changed mode, parameters or software, for years.

- `journal`: its entries and files.
- `log`: the writer.
- `evidence`: the report that is made from the journal.
"""
