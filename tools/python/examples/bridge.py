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

ON, OFF, HARDEST = 0x1237, 0x0240, 20000  # status words; twice the acceleration of the axes, per s2


def reachable(setpoint, at, speed, time_s, state):
    # Begin where the axes are and at rest, go on in steps that they can do (rules 5 and 7 of docs/bridges.md).
    def fits(step, before, after):
        bend, most = abs(step - time_s * (before + after) / 2), HARDEST * time_s
        goes_on = bend < most * time_s / 4 and abs(after - before) < most
        return goes_on if state == bus.BRIDGE_FOLLOWING else abs(step) < 0.005 and abs(after) < 1
    axes = [i for i in range(bus.AXES) if setpoint.axes_mask >> i & 1]
    return all(fits(setpoint.position[i] - at[i], speed[i], setpoint.velocity[i]) for i in axes)


def main(machine, prefix=None):
    bridge = evolvent.Bridge(machine, prefix, timeout_s=86400)
    period = bridge.period_ns
    queue, answer = evolvent.Queue(patience_ns=10 * period), bus.Feedback(bridge_state=bus.BRIDGE_WAITING)
    at, speed, locked, quick, heard, tick = [0.0] * bus.AXES, [0.0] * bus.AXES, False, False, 0, evolvent.monotonic_ns()
    while True:
        for setpoint in bridge.setpoints():
            answer.note = answer.note if queue.put(setpoint, tick) else bus.NOTE_LATE
            quick = setpoint.power_request == bus.POWER_QUICK_STOP  # at once, before it is due
        for setpoint in queue.due(tick):
            time_s, heard, power = (setpoint.due_time_ns - heard) * 1e-9, setpoint.due_time_ns, setpoint.power_request
            # After a quick stop power comes back only by way of off.
            locked = quick or power == bus.POWER_QUICK_STOP or (locked and power != bus.POWER_OFF)
            on = power == bus.POWER_ON and not locked
            fits = setpoint.datum != answer.datum or reachable(setpoint, at, speed, time_s, answer.bridge_state)
            answer.bridge_state = bus.BRIDGE_OFF if not on else bus.BRIDGE_FOLLOWING if fits else bus.BRIDGE_HOLDING
            at, speed = (list(setpoint.position), list(setpoint.velocity)) if on and fits else (at, speed)
            answer.sequence, answer.axes_mask, answer.datum = setpoint.sequence, setpoint.axes_mask, setpoint.datum
            answer.status_word[:] = [ON if on else OFF] * bus.AXES
            answer.phase_error_ns, answer.fault_reset_done = tick - setpoint.due_time_ns, setpoint.fault_reset
        if quick:
            locked, answer.bridge_state, answer.status_word[:] = True, bus.BRIDGE_OFF, [OFF] * bus.AXES
        if tick - heard > 10 * period and answer.bridge_state == bus.BRIDGE_FOLLOWING:
            answer.bridge_state, answer.note = bus.BRIDGE_HOLDING, bus.NOTE_SILENCE  # ideal axes stand at once
        answer.position[:], answer.missed_setpoints = at, queue.missed + bridge.refused
        bridge.answer(answer)
        tick += period
        time.sleep(max(0, tick - evolvent.monotonic_ns()) * 1e-9)


if __name__ == "__main__":
    main(*sys.argv[1:3])
