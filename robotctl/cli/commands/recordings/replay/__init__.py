"""replay: five commands on a recording; the options select one.

- `play`: publish it to ROS with its original timing, or draw it in the terminal (`--draw-only`).
- `checks`: re-run its decisions and compare them (`--check`), re-run them with other parameters
  (`--what-if`), or re-run its drives with a simulated robot (`--resim`).

`command` declares the options and calls one of the five; `screen` shows a replay, and
`select_recordings` finds the recordings among the given files.
"""

from robotctl.cli.commands.recordings.replay.command import app as app
