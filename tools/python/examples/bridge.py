#!/usr/bin/env python3
"""The smallest bridge that drives could live behind, `bridge.py MACHINE [PREFIX]`: ideal axes that are where they shall be.

A real one hands `at` to its drives and reads back where they are. What else it must do stands in docs/bridges.md.
"""

import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import evolvent  # noqa: E402
import evolvent_bus as bus  # noqa: E402

ON, OFF = 0x1237, 0x0240  # status words: operation enabled, switch on disabled


def reachable(setpoint, at, following):
    # Following begins close to the axes and at rest, and goes on in steps that they can do.
    far, fast = (2, 2000) if following else (0.5, 1)
    axes = [i for i in range(bus.AXES) if setpoint.axes_mask >> i & 1]
    return all(abs(setpoint.position[i] - at[i]) < far and abs(setpoint.velocity[i]) < fast for i in axes)


def main(machine, prefix=None):
    bridge = evolvent.Bridge(machine, prefix, timeout_s=86400)
    period = bridge.period_ns
    queue = evolvent.Queue(patience_ns=10 * period)
    answer = bus.Feedback(bridge_state=bus.BRIDGE_WAITING)
    at, locked, quick, heard, tick = [0.0] * bus.AXES, False, False, 0, evolvent.monotonic_ns()
    while True:
        for setpoint in bridge.setpoints():
            answer.note = answer.note if queue.put(setpoint, tick) else bus.NOTE_LATE
            quick = setpoint.power_request == bus.POWER_QUICK_STOP  # at once, before it is due
        for setpoint in queue.due(tick):
            heard, power = setpoint.due_time_ns, setpoint.power_request
            # After a quick stop power comes back only by way of off.
            locked = quick or power == bus.POWER_QUICK_STOP or (locked and power != bus.POWER_OFF)
            on = power == bus.POWER_ON and not locked
            fits = setpoint.datum != answer.datum or reachable(setpoint, at, answer.bridge_state == bus.BRIDGE_FOLLOWING)
            answer.bridge_state = bus.BRIDGE_OFF if not on else bus.BRIDGE_FOLLOWING if fits else bus.BRIDGE_HOLDING
            if on and fits:
                at = list(setpoint.position)
            answer.sequence, answer.axes_mask, answer.datum = setpoint.sequence, setpoint.axes_mask, setpoint.datum
            answer.status_word[:] = [ON if on else OFF] * bus.AXES
            answer.phase_error_ns, answer.fault_reset_done = tick - setpoint.due_time_ns, setpoint.fault_reset
        if quick:
            locked, answer.bridge_state, answer.status_word[:] = True, bus.BRIDGE_OFF, [OFF] * bus.AXES
        if tick - heard > 10 * period and answer.bridge_state == bus.BRIDGE_FOLLOWING:
            answer.bridge_state, answer.note = bus.BRIDGE_HOLDING, bus.NOTE_SILENCE  # ideal axes stand at once
        answer.position[:] = at
        answer.missed_setpoints = queue.missed + bridge.refused
        bridge.answer(answer)
        tick += period
        time.sleep(max(0, tick - evolvent.monotonic_ns()) * 1e-9)


if __name__ == "__main__":
    main(*sys.argv[1:3])
