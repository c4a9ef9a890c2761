"""What ``--help`` prints: the runner's root configuration, whose comments are its manual, in a manual's order."""

import re
from pathlib import Path


def help_text(root: Path) -> str:
    """Name, examples, choices and settings of a runner.

    Args:
        root: its root file in ``configs/``: comment lines first (a title, examples), then ``defaults`` and settings.
    """
    lines = root.read_text(encoding="utf-8").splitlines()
    head = [line.removeprefix("#").strip() for line in lines if line.startswith("#")]
    body = [line for line in lines if not line.startswith(("#", "hydra:"))]
    _, _, title = head[0].partition(": ")
    examples = [f"ursnav {line.removeprefix('python -m ursnav_torch.')}" for line in head[1:] if "python -m" in line]
    notes = [line for line in head[1:] if "python -m" not in line]
    choices = [
        re.sub(r"^  - ([^:]+): ", r"\1=", line)
        for line in body
        if line.startswith("  - ") and not line.startswith(("  - _self_", "  - override"))
    ]
    settings = [line for line in body if line and not line.startswith(("defaults:", "  - "))]
    parts = {
        "NAME": [f"ursnav {root.stem} - {title}", *notes],
        "EXAMPLES": examples,
        "CHOICES, each a file in configs/ (GROUP=CHOICE)": choices,
        "SETTINGS (KEY=VALUE; ??? must be given)": settings,
        "MORE": [
            f"ursnav {root.stem} --cfg job   every setting, those of the choices included, as it would be used",
            "Exit codes: 0 all well, 1 not done, 2 wrong usage, 3 finished but some rows carry an error.",
            "Research software, not a medical device.",
        ],
    }
    return "\n\n".join("\n".join([name, *(f"  {line}" for line in own)]) for name, own in parts.items() if own)
