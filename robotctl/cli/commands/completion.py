"""completion: complete commands and options with Tab, by a static script for each shell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final

import typer

from robotctl.base.errors import Refused
from robotctl.base.text import MODES
from robotctl.cli.commands.drive import MOTIONS
from robotctl.cli.options import Json, new_app, new_group
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import short_path

app = new_app()
group = new_group(app, "completion")


class Shell(StrEnum):
    """A shell that can complete the command line."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


ShellName = Annotated[Shell, typer.Argument(help="The shell.")]

START_FILES: Final = MappingProxyType(
    {
        Shell.BASH: ".bashrc",
        Shell.ZSH: ".zshrc",
        Shell.FISH: ".config/fish/completions/robotctl.fish",
    }
)
"""The file to which `install` adds the script, relative to the home folder."""

BEGIN, END = "# robotctl completion: begin\n", "# robotctl completion: end\n"
"""The script stands between these lines of the start file."""

VALUES: Final = MappingProxyType({"MODE": tuple(MODES), "PATTERN": MOTIONS})
"""The possible values of an argument, by its metavar."""

# The names `path` and `words` are reserved in zsh.
_BASH: Final = """\
_robotctl() {
  local word command="" offered=""
  for word in "${COMP_WORDS[@]:1:$((COMP_CWORD - 1))}"; do
    case "$command $word" in
      @PATHS@) command="$command $word" ;;
    esac
  done
  case "$command" in
@WORDS@
  esac
  COMPREPLY=($(compgen -W "$offered" -- "${COMP_WORDS[COMP_CWORD]}"))
}
complete -o default -F _robotctl robotctl
"""
"""The script for bash and zsh."""

_ZSH: Final = """\
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
autoload -Uz bashcompinit && bashcompinit
"""

_FISH: Final = """\
function __robotctl_path
  set -l path ""
  for word in (commandline -opc)[2..]
    contains -- "$path $word" @PATHS@; and set path "$path $word"
  end
  echo "$path"
end
"""


@group.callback()
def completion() -> None:
    """Let the Tab key complete commands and options, in bash, zsh and fish.

    \b
    Examples:
      robotctl completion install bash
      robotctl completion show zsh
    """


@group.command()
def install(context: typer.Context, shell: ShellName, as_json: Json = False) -> None:
    """Add the completion to the file that the shell reads when it starts.

    After an update of robotctl, install it again for the new commands.

    \b
    Examples:
      robotctl completion install bash
    """
    path = Path.home() / START_FILES[shell]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        old = path.read_text(errors="surrogateescape") if path.exists() else ""
        new = with_script(old, script(shell, context.find_root().command))
        if new.startswith(old):  # usually; appending puts no other content at risk
            with path.open("a", errors="surrogateescape") as file:
                file.write(new[len(old) :])
        else:
            path.write_text(new, errors="surrogateescape")
    except OSError as error:
        raise Refused(f"{path} cannot be changed: {error.strerror}") from error
    told = f"{short_path(path)} has the completion; it works in the next {shell.value}"
    print_answer({"shell": shell.value, "path": str(path)}, [told], as_json=as_json)


@group.command()
def show(context: typer.Context, shell: ShellName) -> None:
    """Print the script, for a start file of your own.

    \b
    Examples:
      robotctl completion show zsh > ~/.zfunc/robotctl.zsh
    """
    print(script(shell, context.find_root().command), end="")


@group.command(
    hidden=True, context_settings={"ignore_unknown_options": True, "allow_extra_args": True}
)
def words() -> None:
    """Print no words: scripts that 0.1 and early 0.2 installed call this, then they offer files."""


def script(shell: Shell, root: Any) -> str:
    """Return the completion script for a shell; `root` is the typer command."""
    table = dict(_table(root))
    if shell is Shell.FISH:
        paths = " ".join(f"'{path}'" for path in table if path)
        lines = []
        for path, words in table.items():
            files = "-f " if any(each.startswith(f"{path} ") for each in table) else ""
            when = f"'test (__robotctl_path) = \"{path}\"'"
            lines.append(f"complete -c robotctl {files}-n {when} -a '{' '.join(words)}'\n")
        return _FISH.replace("@PATHS@", paths) + "".join(lines)
    cases = [f'    "{path}") offered="{" ".join(words)}" ;;' for path, words in table.items()]
    text = _BASH.replace("@PATHS@", "|".join(f'"{path}"' for path in table if path))
    text = text.replace("@WORDS@", "\n".join(cases))
    return _ZSH + text if shell is Shell.ZSH else text


def with_script(text: str, script: str) -> str:
    """Return a shell's start file, read as `text`, with `script` added or replaced."""
    block = f"{BEGIN}{script}{END}"
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if begin and end:
        return f"{head}{block}{tail}"
    gap = "" if not text or text.endswith("\n") else "\n"
    return f"{text}{gap}{block}"


def _table(command: Any, path: str = "") -> Iterator[tuple[str, list[str]]]:
    """Yield the path of the command and of each subcommand, with the words that may follow.

    A path is such as ` recordings rm`; that of `robotctl` is "".
    """
    below: Mapping[str, Any] = {}
    if hasattr(command, "list_commands"):
        every = {name: command.get_command(None, name) for name in command.list_commands(None)}
        below = {name: each for name, each in every.items() if not each.hidden}
    shown = [each for each in command.params if not getattr(each, "hidden", False)]
    options = [name for each in shown for name in (*each.opts, *each.secondary_opts)]
    values = [value for each in shown for value in _values(each)]
    options = [name for name in (*options, "--help") if name.startswith("--")]
    yield path, [*below, *values, *options]
    for name, each in below.items():
        yield from _table(each, f"{path} {name}")


def _values(parameter: Any) -> list[str]:
    """Return the fixed values of an argument, or [] for none."""
    if parameter.param_type_name != "argument":
        return []
    choices = getattr(parameter.type, "choices", ()) or VALUES.get(parameter.metavar or "", ())
    return [str(getattr(each, "value", each)) for each in choices]
