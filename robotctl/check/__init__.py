"""Re-runs recorded decisions in a new kernel; `robotctl.rerun` has the names for library users.

One pass over a recording, in the order of its file (`run`):

1. `journal` puts the entries in order and groups them into snapshots and steps.
2. `compare` gives each event to a new kernel: other decisions make the recording `diverged`, or
   `incomplete` if another version made it.
3. `inputs`, `commands`, `calls` and `statuses` compare the recorded messages with the same steps,
   by number and value; `pairs` holds both sides until what may explain a difference is read.
4. `invariants` and `times` look for what no journal may hold.
5. `ends` tells what may be missing: the recording may be cut, a clip, or received from a robot.

What is wrong makes it `broken`, what could not be compared `incomplete`, otherwise it is the `same`
(`report`). `incident` and `why` explain a stop, `what_if` and `closed_loop` try other parameters.
"""
