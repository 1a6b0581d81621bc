#!/usr/bin/env python3
"""Read every setpoint of a run as a foreign client and check that each number comes once and in order.

    read_setpoints.py --machine NAME [--prefix P] (--count N | --until-last) [--dump FILE] [--json]

Prints the line `ready` when it is about to subscribe: start the run then, with the core waiting for one subscriber.
After the run it prints a summary, with --json as one object. With --dump each setpoint is written as sequence (u64)
and nine positions (f64), little-endian, 80 bytes.

Exit codes: 0 every number once and in order, 1 not so, or time ran out.
"""

import argparse
import json
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tools" / "python"))
import evolvent_bus as bus  # noqa: E402

SEQUENCE = bus.Setpoint.sequence
POSITION = bus.Setpoint.position


def read(arguments):
    """Reads until the end that was asked for; returns the summary and what to dump."""
    print("ready", flush=True)
    reader = bus.open_setpoints(arguments.machine, arguments.prefix, arguments.timeout)
    attributes = reader.attributes
    print("subscribed", file=sys.stderr, flush=True)

    dump = bytearray()
    count = lost = repeated = backwards = late = 0
    first = last = None
    ended = "timeout"
    idle_since = time.monotonic()
    while True:
        setpoint = reader.receive()
        if setpoint is None:
            if time.monotonic() - idle_since > arguments.timeout:
                break
            # Short enough to keep far from the end of the buffer, long enough to leave the core its processor.
            time.sleep(0.0005)
            continue
        idle_since = time.monotonic()
        sequence = setpoint.sequence
        if first is None:
            first = sequence
        elif sequence > last + 1:
            lost += sequence - last - 1
        elif sequence == last:
            repeated += 1
        elif sequence < last:
            backwards += 1
        last = sequence
        count += 1
        late += bool(setpoint.flags & bus.FLAG_LATE)
        if arguments.dump:
            raw = memoryview(setpoint).cast("B")
            dump += raw[SEQUENCE.offset : SEQUENCE.offset + SEQUENCE.size]
            dump += raw[POSITION.offset : POSITION.offset + POSITION.size]
        if arguments.count is not None and count >= arguments.count:
            ended = "count"
            break
        if arguments.until_last and setpoint.flags & bus.FLAG_LAST:
            ended = "last"
            break
    if arguments.dump:
        pathlib.Path(arguments.dump).write_bytes(dump)
    in_order = count > 0 and lost == 0 and repeated == 0 and backwards == 0
    return {
        "count": count,
        "first": first,
        "last": last,
        "lost": lost,
        "repeated": repeated,
        "backwards": backwards,
        "late": late,
        "ended": ended,
        "once_and_in_order": in_order,
        "interface": attributes.get(bus.ATTRIBUTE_INTERFACE),
        "period_ns": int(attributes.get(bus.ATTRIBUTE_PERIOD, 0)),
        "axes": attributes.get(bus.ATTRIBUTE_AXES),
    }


def main():
    """Parses the command line, reads, reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machine", required=True, help="the machine's name")
    parser.add_argument("--prefix", help="iceoryx2 prefix of the core, if it has one")
    end = parser.add_mutually_exclusive_group(required=True)
    end.add_argument("--count", type=int, help="stop after this many setpoints")
    end.add_argument("--until-last", action="store_true", help="stop after the setpoint that is flagged as the last")
    parser.add_argument("--timeout", type=float, default=20.0, help="seconds to wait for the core and between setpoints")
    parser.add_argument("--dump", help="file for sequence numbers and positions")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    try:
        summary = read(arguments)
    except (TimeoutError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if arguments.json:
        print(json.dumps(summary))
    else:
        print("\n".join(f"{key}: {value}" for key, value in summary.items()))
    return 0 if summary["once_and_in_order"] and summary["ended"] != "timeout" else 1


if __name__ == "__main__":
    sys.exit(main())
