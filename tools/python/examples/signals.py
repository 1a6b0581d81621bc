#!/usr/bin/env python3
"""A bridge of outputs and inputs: digital outputs wired to digital inputs, and inputs that are always on.

    signals.py NAME [PREFIX] [--wire OUTPUT:INPUT]... [--closed INPUT]...

Replace `read` by your own terminals. Outputs count when they are due; without a message for 200 ms their safe values do.
"""

import argparse
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import evolvent_bus as bus  # noqa: E402

SILENCE_NS = 200_000_000


class Outputs:
    """Messages of outputs, each in force when it is due."""

    def __init__(self, reader):
        self._reader, self._ahead, self._now, self._heard_ns = reader, [], None, 0

    def now(self):
        """Sequence and digital outputs of this moment; safe ones are of no message."""
        while (message := self._reader.receive()) is not None:
            if self._ahead and message.sequence <= self._ahead[-1].sequence:
                self._ahead.clear()
            self._ahead.append(message)
            self._heard_ns = time.monotonic_ns()
        while self._ahead and self._ahead[0].due_time_ns <= time.monotonic_ns():
            self._now = self._ahead.pop(0)
        if self._now is None:
            return 0, 0
        is_silent = time.monotonic_ns() - self._heard_ns > SILENCE_NS
        return (0, self._now.safe_digital) if is_silent else (self._now.sequence, self._now.digital)


def read(digital, wires, closed):
    """Mask and states of the digital inputs."""
    mask = states = closed
    for output, wired in wires:
        mask |= 1 << wired
        states |= (digital >> output & 1) << wired
    return mask, states


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name")
    parser.add_argument("prefix", nargs="?")
    parser.add_argument("--wire", action="append", default=[], metavar="OUTPUT:INPUT")
    parser.add_argument("--closed", action="append", default=[], type=int, metavar="INPUT")
    arguments = parser.parse_args()
    wires = [tuple(map(int, wire.split(":"))) for wire in arguments.wire]
    closed = sum(1 << number for number in arguments.closed)
    outputs = Outputs(bus.open_outputs(arguments.name, arguments.prefix, 60.0))
    sender = bus.open_inputs(arguments.name, arguments.prefix, 60.0)
    sequence, instance = 0, time.time_ns()
    while True:
        set_last, digital = outputs.now()
        mask, states = read(digital, wires, closed)
        sequence += 1
        sender.send(
            bus.MachineInputs(
                sequence=sequence,
                time_ns=time.monotonic_ns(),
                instance=instance,
                outputs_sequence=set_last,
                digital_mask=mask,
                digital=states,
            )
        )
        time.sleep(0.005)


if __name__ == "__main__":
    main()
