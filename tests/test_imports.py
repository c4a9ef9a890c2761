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


def test_nothing_but_the_simulation_needs_posix() -> None:
    """Every module outside ``simulation/`` is imported where POSIX's modules and signals are missing."""
    code = """
import importlib, pkgutil, signal, sys
import serial  # which chooses what the system at hand needs
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
del signal.SIGHUP
import ursnav_torch
for module in pkgutil.walk_packages(ursnav_torch.__path__, "ursnav_torch."):
    if not module.name.startswith("ursnav_torch.simulation") and not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ImportError as error:
            if "None in sys.modules" in str(error):
                print(module.name, error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("", 0), done.stdout + done.stderr
