"""The two channels of a drive bridge, and a queue for what is sent ahead of time."""

from __future__ import annotations

import collections
import time
from typing import Any, Deque, Iterator, Optional

import evolvent_bus as bus


def monotonic_ns() -> int:
    """Now, by the clock of `due_time_ns` and `time_ns`."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Bridge:
    """One bridge of one machine.

    Waits for the core for at most `timeout_s` seconds: `TimeoutError` then, `RuntimeError` where the core speaks another
    version of the contract. A core that goes and comes back is found again by itself, as long as its axes and period
    stay.
    """

    def __init__(self, machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> None:
        self._reader = bus.open_setpoints_of_bridge(machine_name, prefix, timeout_s)
        self._node = bus.open_node(machine_name, prefix, timeout_s)
        self._service = bus.open_service(self._node, machine_name, "feedback", bus.Feedback, timeout_s)
        self._publisher: Any = self._service.publisher_builder().create()
        self.refused = 0
        """Setpoints of another interface version, which were dropped."""
        self.instance = monotonic_ns()
        """Tells this start of the bridge from others; `answer` fills it in."""

    @property
    def period_ns(self) -> int:
        """The core's period."""
        return int(self._reader.attributes[bus.ATTRIBUTE_PERIOD])

    @property
    def axes(self) -> str:
        """The letters of the machine's axes, in order."""
        return self._reader.attributes[bus.ATTRIBUTE_AXES]

    def setpoints(self) -> Iterator[bus.Setpoint]:
        """Every setpoint that has come since the last call, oldest first. Does not wait."""
        while True:
            try:
                setpoint = self._reader.receive()
            except RuntimeError:
                self.refused += 1
                continue
            if setpoint is None:
                return
            yield setpoint

    def answer(self, feedback: bus.Feedback) -> None:
        """Sends feedback; `time_ns` is set to now where it is 0."""
        feedback.instance = self.instance
        feedback.time_ns = feedback.time_ns or monotonic_ns()
        self._publisher.loan_uninit().write_payload(feedback).send()
        feedback.time_ns = 0


# No core computes setpoints further ahead, ns.
FURTHEST_NS = 10_000_000_000


class Queue:
    """Setpoints in order of their due times. Those whose due times cannot be used are counted and dropped: too late, far ahead, or
    not after that of the setpoint before."""

    def __init__(self, patience_ns: int) -> None:
        self.patience_ns = patience_ns
        self.missed = 0
        """Setpoints that were missing in the sequence, or late."""
        self._waiting: Deque[bus.Setpoint] = collections.deque(maxlen=4096)
        self._last: Optional[int] = None
        self._last_due_ns = 0

    def put(self, setpoint: bus.Setpoint, now_ns: int) -> bool:
        """Keeps a setpoint; False if its due time cannot be used."""
        continues = self._last is not None and setpoint.sequence > self._last
        is_backwards = continues and setpoint.due_time_ns <= self._last_due_ns
        if is_backwards or not now_ns - self.patience_ns <= setpoint.due_time_ns <= now_ns + FURTHEST_NS:
            self.missed += 1
            return False
        if self._last is not None and setpoint.sequence > self._last + 1:
            self.missed += setpoint.sequence - self._last - 1
        if self._last is not None and setpoint.sequence <= self._last:
            self._waiting.clear()  # another core: what the old one had ordered is void
        self._last, self._last_due_ns = setpoint.sequence, setpoint.due_time_ns
        self._waiting.append(setpoint)
        return True

    def due(self, now_ns: int) -> Iterator[bus.Setpoint]:
        """Takes out, one after the other, what is due."""
        while self._waiting and self._waiting[0].due_time_ns <= now_ns:
            yield self._waiting.popleft()
