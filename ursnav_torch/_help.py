"""What ``--help`` prints: the runner's root configuration, whose comments are its manual, in a manual's order; and what
somebody may have meant who gave a setting that is none."""

import difflib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig


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


def misspelled(root: Path, arguments: Sequence[str]) -> list[str]:
    """A sentence about each ``key=value`` whose key is no setting of a runner, given its choices, with what is near it.

    Args:
        root: its root file in ``configs/``.
        arguments: as given on the command line.
    """
    given = [argument.partition("=")[0] for argument in arguments if "=" in argument]
    groups = [key for key in given if (root.parent / key).is_dir()]
    choices = [argument for argument in arguments if argument.partition("=")[0] in groups]
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(root.parent), version_base="1.3"):
        settings = list(_settings(compose(root.stem, choices)))
    told = []
    for key in given:
        if key in groups or key in settings or key.startswith(("+", "~", "hydra.")):
            continue
        last = key.rpartition(".")[2]
        near = [name for name in settings if name.rpartition(".")[2] == last]
        near += difflib.get_close_matches(key, [name for name in settings if name not in near], 3, 0.7)
        meant = f"; near it: {', '.join(near[:3])}" if near else ""
        told.append(f"{key!r} is no setting of {root.stem}{meant}. `ursnav {root.stem} --cfg job` shows them all.")
    return told


def _settings(config: DictConfig, above: str = "") -> Iterator[str]:
    """Names of all settings, inner ones with dots."""
    for key in map(str, config):
        yield f"{above}{key}"
        if isinstance(value := config._get_node(key), DictConfig) and not value._is_none():
            yield from _settings(value, f"{above}{key}.")
