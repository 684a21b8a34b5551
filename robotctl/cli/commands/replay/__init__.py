"""replay: five commands on a recording; the options select one.

- `play`: publish it to ROS with its original timing.
- `drawn`: draw it in the terminal, without ROS (`--draw-only`).
- `check`: re-run its decisions and compare them (`--check`).
- `what_if`: re-run its decisions with other parameters (`--what-if`).
- `resim`: re-run its drives with a simulated robot (`--resim`).

`command` declares the options and calls one of the five.
"""

from robotctl.cli.commands.replay.command import app as app
