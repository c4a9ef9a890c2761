"""The quickest runner, disturbed in every way a few times."""

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_a_disturbed_runner_ends_in_the_same_bytes() -> None:
    """In a process of its own: it forks, which must be done before any thread is started."""
    command = [sys.executable, "-m", "benchmarks.chaos", "kills=1", "others=1", "only=register"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "0 faults" in done.stdout, done.stdout + done.stderr
