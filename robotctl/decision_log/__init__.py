"""The long-lived journal of decisions: who changed mode, parameters or software, for years.

- `entries`: an entry as a line of JSON, chained to the line before it.
- `folder`: the files of the log, and which of them are old.
- `budget`: how much may be written a day.
- `log`: the writer, with a thread of its own.
- `read`: the entries, and what is wrong with the files.
"""
