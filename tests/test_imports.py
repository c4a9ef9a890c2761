"""What a program loads: no more than it needs."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("modules", "kept_out"),
    [
        ("ursnav_torch", ("torch", "numpy", "hydra")),
        ("ursnav_torch.match, ursnav_torch.runs.match", ("matplotlib", "viser", "starlette", "serial")),
        ("ursnav_torch.localization", ("hydra", "omegaconf", "matplotlib")),
    ],
)
def test_importing_leaves_out_what_it_does_not_need(modules: str, kept_out: tuple[str, ...]) -> None:
    code = f"import sys, {modules}; print(*(m for m in {kept_out!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
