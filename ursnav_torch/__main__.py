"""``ursnav`` (``python -m ursnav_torch``) lists the runners and starts one of them: ``ursnav match vid=my_vid ...``."""

import ast
import difflib
import sys
from importlib import import_module
from pathlib import Path

_HELP = ("-h", "--help", "help")


def runners() -> dict[str, str]:
    """Name and first docstring line of every runner, without importing any."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" and node.decorator_list for node in tree.body):
            found[path.stem] = (ast.get_docstring(tree) or "").splitlines()[0]
    return found


def main() -> None:
    """Do what the command line says; the exit codes are the runners' own."""
    name, *rest = sys.argv[1:] or ["--help"]
    known = runners()
    if name in known:
        sys.argv = [f"ursnav {name}", *rest]
        import_module(f"ursnav_torch.{name}").main()
    elif name in _HELP:
        _print_list(known)
    elif name == "--version":
        from importlib.metadata import version

        print(f"ursnav-torch {version('ursnav-torch')}")
    elif name == "--completion":
        from ursnav_torch.completion import completion_script

        sys.exit(_print_script(completion_script(rest[0] if rest else "", list(known))))
    else:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"Did you mean {near[0]}?" if near else f"There are {', '.join(known)}."
        print(f"error: there is no runner {name!r}. {hint}", file=sys.stderr)
        sys.exit(2)


def _print_list(known: dict[str, str]) -> None:
    print("Usage: ursnav RUNNER key=value ...      (the same as python -m ursnav_torch.RUNNER key=value ...)\n")
    for name, line in known.items():
        print(f"  {name:14s}{line}")
    print("\nursnav RUNNER --help   its settings, with examples")
    print("ursnav --version       the version")
    print('ursnav --completion bash|zsh|fish   a script for the shell:  eval "$(ursnav --completion bash)"')
    print("\nResearch software, not a medical device.")


def _print_script(script: str | None) -> int:
    if script is None:
        print("error: completion is there for bash, zsh and fish: ursnav --completion bash", file=sys.stderr)
        return 2
    print(script)
    return 0


if __name__ == "__main__":
    main()
