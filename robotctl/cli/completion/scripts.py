"""The scripts that make a shell ask robotctl for what may follow.

Each calls `robotctl completion words`, which prints a candidate a line, with its meaning after a
tab; without a candidate the shell offers files. Nothing of the answer is evaluated.
"""

from __future__ import annotations

from enum import Enum
from pathlib import Path

_BASH = """\
_robotctl() {
  local line
  COMPREPLY=()
  while IFS= read -r line; do
    COMPREPLY+=("${line%%$'\\t'*}")
  done < <("$1" completion words -- "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)
}
complete -o default -F _robotctl robotctl
"""

_ZSH = """\
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
_robotctl() {
  local line
  local -a found
  while IFS= read -r line; do
    found+=("${line/$'\\t'/:}")
  done < <("$words[1]" completion words -- "${(@)words[2,CURRENT]}" 2>/dev/null)
  if (( $#found )); then _describe robotctl found; else _files; fi
}
compdef _robotctl robotctl
"""

_FISH = """\
function __robotctl_words
  set -l words (commandline -opc)
  set -l found ($words[1] completion words -- $words[2..] "$(commandline -ct)" 2>/dev/null)
  if test (count $found) -gt 0
    printf '%s\\n' $found
  else
    __fish_complete_path "$(commandline -ct)"
  end
end
complete -c robotctl -f -a '(__robotctl_words)'
"""


class Shell(Enum):
    """A shell that can complete the command line."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"

    @property
    def script(self) -> str:
        """What the shell has to run when it starts."""
        return {Shell.BASH: _BASH, Shell.ZSH: _ZSH, Shell.FISH: _FISH}[self]

    def start_file(self, home: Path) -> Path:
        """Return the file that the shell reads when it starts."""
        return (
            home
            / {
                Shell.BASH: ".bashrc",
                Shell.ZSH: ".zshrc",
                Shell.FISH: ".config/fish/completions/robotctl.fish",
            }[self]
        )
