"""Threads of a long session share the allocator's arenas."""

import platform
import subprocess
import sys
import threading

import pytest
import torch

from ursnav_torch.threads import map_chunks, meanwhile, one_thread_an_operation

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


@pytest.mark.parametrize("threads", [1, 2])
def test_work_meanwhile_gives_its_result_in_the_mode_of_who_started_it(threads: int, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    with torch.inference_mode():
        who, mode = meanwhile(lambda: (threading.get_ident(), torch.is_inference_mode_enabled()))()
    assert mode and (who == threading.get_ident()) == (threads == 1)


def test_an_error_of_work_meanwhile_is_raised_where_the_result_is_asked_for(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    wait = meanwhile(lambda: [][0])
    with pytest.raises(IndexError):
        wait()


def test_an_operation_stays_on_one_thread_in_every_thread_that_works_at_once() -> None:
    before, counts = torch.get_num_threads(), []
    ready, go = threading.Barrier(2), threading.Barrier(2)

    def beside() -> None:
        torch.zeros(8).sum()
        counts.append(torch.get_num_threads())
        ready.wait(10)
        go.wait(10)  # until the other thread is inside
        with one_thread_an_operation() as outside:
            counts.extend([torch.get_num_threads(), outside])
        counts.append(torch.get_num_threads())

    torch.set_num_threads(2)
    try:
        other = threading.Thread(target=beside)
        other.start()
        ready.wait(10)
        with one_thread_an_operation() as outside:
            go.wait(10)
            other.join(10)
            assert (torch.get_num_threads(), outside) == (1, 2)
        assert torch.get_num_threads() == 2
        assert counts == [2, 1, 2, 2]
    finally:
        torch.set_num_threads(before)


def test_chunks_and_work_meanwhile_keep_to_one_thread_an_operation() -> None:
    before, counts = torch.get_num_threads(), []
    torch.set_num_threads(2)
    try:
        map_chunks(lambda part: counts.append(torch.get_num_threads()), 4, 1, 1e9)
        counts.append(meanwhile(torch.get_num_threads)())
    finally:
        torch.set_num_threads(before)
    assert counts == [1] * 5
