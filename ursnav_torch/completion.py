"""Completion for shells: the runners' names, and for each runner the keys and choices of its configuration."""

from collections.abc import Sequence
from pathlib import Path

from ursnav_torch._runner import config_dir

_BASH = """_ursnav() {{
  local word="${{COMP_WORDS[COMP_CWORD]}}" words
  COMP_WORDBREAKS="${{COMP_WORDBREAKS//=/}}"
  if [ "$COMP_CWORD" = 1 ]; then words="{runners} --help --version"
  else case "${{COMP_WORDS[1]}}" in
{cases}
  esac; fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
  if [ -z "${{COMPREPLY[*]}}" ] && [[ "$word" == *=* ]]; then
    COMPREPLY=($(compgen -P "${{word%%=*}}=" -f -- "${{word#*=}}"))
  fi
  [[ "${{COMPREPLY[0]}}" == *= ]] && compopt -o nospace
}}
complete -F _ursnav ursnav"""


def completion_script(shell: str, runners: Sequence[str]) -> str | None:
    """The script that teaches a shell to complete ``ursnav``; None for a shell that is not known."""
    words = {name: runner_words(name) for name in runners}
    if shell in ("bash", "zsh"):
        cases = "\n".join(f'    {name}) words="{" ".join(keys)}" ;;' for name, keys in words.items())
        script = _BASH.format(runners=" ".join(runners), cases=cases)
        return script if shell == "bash" else f"autoload -U +X bashcompinit && bashcompinit\n{script}"
    if shell == "fish":
        first = f'complete -c ursnav -n __fish_use_subcommand -f -a "{" ".join(runners)}"'
        rest = (
            f'complete -c ursnav -n "__fish_seen_subcommand_from {name}" -a "{" ".join(keys)}"'
            for name, keys in words.items()
        )
        return "\n".join((first, *rest))
    return None


def runner_words(runner: str) -> list[str]:
    """``key=`` for every key of a runner's root configuration, and ``group=choice`` for what can be chosen there."""
    from omegaconf import OmegaConf

    folder = Path(config_dir())
    root = OmegaConf.to_container(OmegaConf.load(folder / f"{runner}.yaml"))
    assert isinstance(root, dict)
    keys = [str(key) for key in root if key not in ("defaults", "hydra")]
    groups = [str(key).removeprefix("optional ") for item in root.get("defaults", []) if isinstance(item, dict)
              for key in item if not str(key).startswith("override")]  # fmt: skip
    choices = [
        f"{group.split('@')[0]}={path.stem}"
        for group in groups
        for path in sorted((folder / group.split("@")[0]).glob("*.yaml"))
    ]
    return [*(f"{key}=" for key in keys if key not in groups), *choices]
