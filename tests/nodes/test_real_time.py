"""What a process asks of the kernel is put back, and refusals are told."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

from softbot.nodes import real_time as module
from softbot.nodes.real_time import real_time, swaps


def test_what_was_there_before_is_left_alone_by_the_collector() -> None:
    before = gc.get_freeze_count()
    with real_time() as granted:
        assert gc.get_freeze_count() > before + 1000
        assert granted == (False, False, ())
    assert gc.get_freeze_count() == 0


def test_a_priority_that_is_granted_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    set_to: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda who, policy, parameter: set_to.append(policy))
    before = os.sched_getscheduler(0)
    with real_time(urgent=True) as granted:
        assert granted.priority
        assert set_to == [os.SCHED_FIFO]
    assert set_to == [os.SCHED_FIFO, before]


def test_memory_is_kept_where_there_is_no_swap(tmp_path: Path) -> None:
    table = tmp_path / "swaps"
    table.write_text("Filename\t\t\t\tType\t\tSize\n")
    assert not swaps(table)
    table.write_text("Filename\t\t\t\tType\t\tSize\n/swapfile file 1\n")
    assert swaps(table)
    assert swaps(tmp_path / "none")


def test_refusals_say_what_would_allow_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    class Library:
        def mlockall(self, flags: int) -> int:
            return -1

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(module, "swaps", lambda: True)
    monkeypatch.setattr(module.ctypes, "CDLL", lambda *_, **__: Library())
    with real_time(urgent=True) as granted:
        assert not granted.priority
        assert not granted.memory_kept
        assert "rtprio 20" in granted.refused[0]
        assert "memlock" in granted.refused[1]
