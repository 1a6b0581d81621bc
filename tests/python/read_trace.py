#!/usr/bin/env python3
"""Reads a trace with the public `mcap` and `mcap-protobuf-support` packages, knowing nothing of Evolvent.

    read_trace.py FILE --json          checks that every cycle is there once and in order; prints counts and values
    read_trace.py FILE --dump OUT      also writes each cycle as sequence (u64) and nine positions (f64, zero for
                                       axes that the machine lacks), little-endian, 80 bytes: as read_setpoints.py
                                       does with what the bus carried

Exit code 0 if the sequences are contiguous and every message decodes, 1 otherwise.
"""

import argparse
import json
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def described(message):
    """A cycle as plain data."""
    return {
        "sequence": message.sequence,
        "due_time_ns": message.due_time_ns,
        "wake_lateness_ns": message.wake_lateness_ns,
        "work_ns": message.work_ns,
        "path_mm": message.path_mm,
        "feed_mm_s": message.feed_mm_s,
        "position": list(message.position),
        "velocity": list(message.velocity),
        "acceleration": list(message.acceleration),
        "jerk": list(message.jerk),
        "line": message.line,
        "state": message.DESCRIPTOR.fields_by_name["state"].enum_type.values_by_number[message.state].name,
        "flags": message.flags,
        "override": message.override,
        "load": message.load if message.HasField("load") else None,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--dump", metavar="OUT", help="sequence and positions as raw bytes")
    arguments = parser.parse_args()

    counts = {}
    cycles = gaps = misdated = 0
    first = last = axes = None
    dump = open(arguments.dump, "wb") if arguments.dump else None
    with open(arguments.file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        attachments = {record.name: len(record.data) for record in reader.iter_attachments()}
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if channel.topic != "/cycle":
                continue
            axes = axes or channel.metadata.get("axes")
            if last is not None and decoded.sequence != last.sequence + 1:
                gaps += 1
            stamp = decoded.timestamp.seconds * 1_000_000_000 + decoded.timestamp.nanos
            if not message.log_time == decoded.due_time_ns == stamp or len(decoded.position) != len(axes):
                misdated += 1
            first = first or decoded
            last = decoded
            cycles += 1
            if dump:
                by_letter = dict(zip(axes, decoded.position))
                nine = (by_letter.get(letter, 0.0) for letter in "XYZABCUVW")
                dump.write(struct.pack("<Q9d", decoded.sequence, *nine))
    if dump:
        dump.close()

    report = {
        "axes": axes,
        "cycles": cycles,
        "gaps": gaps,
        "inconsistent": misdated,
        "counts": counts,
        "first": described(first) if first else None,
        "last": described(last) if last else None,
        "run": metadata.get("evolvent.run"),
        "summary": metadata.get("evolvent.summary"),
        "attachments": attachments,
    }
    if arguments.json:
        json.dump(report, sys.stdout)
        print()
    else:
        print(f"{cycles} cycles of axes {axes}, {gaps} gaps, {misdated} inconsistent; {counts}")
    return 0 if gaps == 0 and misdated == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
