"""The long-lived journal of decisions: who changed mode, parameters or software, for years.

- `journal`: its entries and files, and what is wrong with them.
- `log`: the writer.
- `evidence`: what the journal tells, as one report.
"""
