"""Re-run recorded decisions in a new kernel; `robotctl.rerun` has the names for library users.

`run` reads a recording once, in the order of its files:

1. `journal` puts entries in order: snapshots (kernel states) and steps (event and effects).
2. `compare` gives each event to a new kernel: other decisions make the recording `diverged`, or
   `incomplete` if another version made it.
3. `inputs`, `commands`, `calls` and `statuses` compare the recorded messages with these steps, by
   number and value; `topics.Waiting` keeps messages and steps until differences can be judged.
4. `invariants` and `times` check what must hold in every journal.
5. `ends` decides what may be missing: the recording may be cut, a clip, or received from a robot.

The verdict (`report`) is `broken` if something is wrong, `incomplete` if something could not be
compared, else `same`. `incident` and `why` explain a stop; `what_if` and `closed_loop` try other
parameters.
"""
