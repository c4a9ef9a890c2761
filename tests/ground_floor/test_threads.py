"""Threads of a long session share the allocator's arenas."""

import platform
import subprocess
import sys

import pytest

#: Prints how many arenas twelve threads made that allocate at the same time; ``malloc_info`` tells them.
TWELVE = """
import ctypes, sys, threading
{first}
libc, together = ctypes.CDLL(None), threading.Barrier(12)
def work():
    together.wait()
    kept = [bytes(4000) for _ in range(100)]
    together.wait()
threads = [threading.Thread(target=work) for _ in range(12)]
[t.start() for t in threads], [t.join() for t in threads]
libc.fdopen.restype, libc.malloc_info.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
stdout = libc.fdopen(1, b"w")
libc.malloc_info(0, stdout), libc.fflush(ctypes.c_void_p(stdout))
"""


def arenas(first: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", TWELVE.format(first=first)], capture_output=True, text=True, check=True
    )
    return done.stdout.count("<heap ")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="arenas are glibc's")
def test_threads_share_two_arenas_and_have_more_otherwise() -> None:
    assert arenas("") > 2
    assert arenas("from ursnav_torch.threads import share_arenas; assert share_arenas()") == 2
