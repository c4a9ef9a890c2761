"""``python -m ursnav_torch`` lists the runners, a line each."""

import ast
from pathlib import Path


def runners() -> dict[str, str]:
    """Name and first docstring line of every runner, without importing any."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" and node.decorator_list for node in tree.body):
            found[path.stem] = (ast.get_docstring(tree) or "").splitlines()[0]
    return found


def main() -> None:
    """Print the list."""
    print("Runners, each with --help:  python -m ursnav_torch.<runner> key=value ...\n")
    for name, line in runners().items():
        print(f"  {name:14s}{line}")
    print("\nResearch software, not a medical device.")


if __name__ == "__main__":
    main()
