"""Signals that save and stop a long command."""

from __future__ import annotations

import signal
import threading

import pytest

from dockctl.experiments.interrupt import interruptible, on_interrupt


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_and_its_handler_is_restored(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    calls: list[None] = []
    with on_interrupt(lambda: calls.append(None)):
        signal.raise_signal(number)
    assert len(calls) == 1
    assert signal.getsignal(number) is before


def test_a_second_ctrl_c_ends_at_once_and_a_second_hangup_does_not() -> None:
    with interruptible() as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_an_interruption_is_announced_once_and_not_by_the_signal_handler() -> None:
    said: list[str] = []
    with interruptible(lambda: said.append("saving")) as interrupted:
        interrupted()
        signal.raise_signal(signal.SIGINT)
        assert not said
        assert interrupted() and interrupted()
    assert said == ["saving"]


def test_a_hangup_that_nohup_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interruptible() as interrupted:
            signal.raise_signal(signal.SIGHUP)
            assert not interrupted()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_the_main_thread_signals_stay_as_they_are() -> None:
    """Python sets handlers in the main thread only; a notebook or a server may train in another one."""
    seen: list[bool] = []

    def work() -> None:
        with interruptible() as interrupted:
            seen.append(interrupted())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]
