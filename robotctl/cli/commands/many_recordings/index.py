"""index: write an index beside each recording; `find` answers from the indexes."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from robotctl.base.errors import UnreadableFile
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import open_catalogue
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import short_path, size

app = new_app()


@app.command()
def index(
    folder: Annotated[
        str | None,
        typer.Argument(
            metavar="[DIR]",
            help="A folder of recordings [default: ./recordings, or the daemon's, or the last "
            "daemon's].",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Make the index beside each recording that has none, or an old one.

    An index is a small Parquet file: drives, events, losses, rates, parameters, samples of pose
    and command, and the verdicts of `replay --check` and `verify`. `find` answers from it. Needs
    the extra robotctl[parquet]; needs neither ROS nor a daemon. The exit code is 6 if a recording
    could not be indexed.

    \b
    Examples:
      robotctl index
      robotctl index /data/robots --json
    """
    with open_catalogue(folder, quiet=as_json) as (place, catalogue):
        bytes_of = [os.stat(each).st_size for each in catalogue.indexes]
        answer = {
            "folder": str(place),
            "indexed": len(catalogue.indexes),
            "bytes": sum(bytes_of),
            "left_out": list(catalogue.left_out),
            "failures": {str(path): said for path, said in catalogue.failures.items()},
        }
    counted = "1 recording has" if len(bytes_of) == 1 else f"{len(bytes_of)} recordings have"
    lines = [
        f"{short_path(place)}: {counted} an index, {size(sum(bytes_of))}",
        *catalogue.left_out,
    ]
    failed = len(catalogue.failures)
    error = UnreadableFile(f"{failed} recordings could not be indexed") if failed else None
    print_answer(answer, lines, as_json=as_json, error=error)
