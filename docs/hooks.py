"""What the site takes from elsewhere in the repository, so that nothing is written twice."""

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
#: Pages that are a file of the repository as it stands.
TAKEN = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The page's text, with what it only names filled in."""
    taken = TAKEN.get(page.file.src_uri)
    if taken:
        return take(taken)
    return formulas(markdown.replace("<!-- results -->", results()) if page.file.src_uri == "figures.md" else markdown)


def formulas(markdown: str) -> str:
    """The text with LaTeX between dollars as MathML, which browsers draw by themselves."""
    from latex2mathml.converter import convert

    markdown = re.sub(
        r"\$\$(.+?)\$\$", lambda m: convert(" ".join(m[1].split()), display="block"), markdown, flags=re.S
    )
    return re.sub(r"(?<![\w$`])\$([^$\n`]+)\$(?!\w)", lambda m: convert(m[1]), markdown)


def take(name: str) -> str:
    """A file of the repository, its links as they are from ``docs/``; links to code go by name alone."""
    text = (ROOT / name).read_text(encoding="utf-8")
    text = re.sub(r"\]\(docs/", "](", text)
    text = re.sub(r"^```(\w+) \S+$", r"```\1", text, flags=re.M)
    return re.sub(r"\[([^\]]+)\]\((?!https?:|#|\w+\.(?:png|webp|md))[^)]*\)", r"\1", text)


def results() -> str:
    """Every stored benchmark result as a table, with the command that printed it."""
    parts = []
    for path in sorted((ROOT / "benchmarks" / "results").glob("*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        processor, suite = data["machine"]["processor"], data["suite"]
        told = f"`python -m benchmarks.{suite}` at {data['commit']}, {data['date']}, on {processor}."
        parts += [f"## {suite}", "", told, ""]
        parts += ["| what | figure | median | unit | n |", "|---|---|--:|---|--:|"]
        parts += [_row(row) for row in data["rows"]] + [""]
    return "\n".join(parts)


def _row(row: dict[str, Any]) -> str:
    cells = (row.get("group", ""), row.get("name", ""), row.get("median", ""), row.get("unit", ""), row.get("n", ""))
    shown = (f"{c:.4g}" if isinstance(c, float) else str(c).replace("|", "\\|") for c in cells)
    return f"| {' | '.join(shown)} |"
