"""Reads every cycle of an Evolvent trace, whichever way it was recorded.

    pip install mcap mcap-protobuf-support

    import evolvent_trace
    for cycle in evolvent_trace.cycles("run.mcap"):
        print(cycle.sequence, cycle.position)

    python evolvent_trace.py run.mcap        counts the cycles and prints the last

A trace holds one message a cycle (`/cycle`), or exact columns (`/cycles`), where `/cycle` is a thinned view. docs/trace-format.md
describes the columns; this module decodes them, value by value, to the same bits.
"""

import math
import struct
import sys
from types import SimpleNamespace

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

NAMES = {
    4: "wake_lateness_ns", 5: "work_ns", 6: "path_mm", 7: "feed_mm_s", 8: "position", 9: "velocity", 10: "acceleration",
    11: "jerk", 12: "line", 13: "state", 14: "flags", 15: "override", 16: "load", 17: "inputs", 18: "following_error",
    19: "drive_position",
}
WHOLE = {4, 5, 12, 13, 14, 17}
PER_AXIS = {8, 9, 10, 11, 18, 19}
JERK = 11
ABSENT = {16, 18, 19}
# First and second derivative, by field.
DERIVATIVES = {10: (11, None), 9: (10, 11), 8: (9, 10)}
MASK = (1 << 64) - 1


def signed(value):
    return value - (1 << 64) if value >> 63 else value


def ordered(value, single):
    """A number as a whole number in the order of sizes."""
    if single:
        try:
            packed = struct.pack("<f", value)
        except OverflowError:
            packed = struct.pack("<f", math.copysign(math.inf, value))
        bits = struct.unpack("<i", packed)[0]
        return bits ^ 0x7FFFFFFF if bits < 0 else bits
    bits = struct.unpack("<q", struct.pack("<d", value))[0]
    return bits ^ 0x7FFFFFFFFFFFFFFF if bits < 0 else bits


def number(whole, single):
    """Back from that."""
    if single:
        bits = whole & 0xFFFFFFFF
        if bits >> 31:
            bits ^= 0x7FFFFFFF
        return struct.unpack("<f", struct.pack("<I", bits))[0]
    bits = whole & MASK
    if bits >> 63:
        bits ^= 0x7FFFFFFFFFFFFFFF
    return struct.unpack("<d", struct.pack("<Q", bits))[0]


def rests(data, count):
    """The numbers of the adaptive Rice code."""
    stream, at, total, found = int.from_bytes(data, "little"), 0, 0, []
    for _ in range(count):
        k = min(min(total * 11, MASK) >> 8, MASK).bit_length()
        k = min(k, 48)
        ones = 0
        while ones < 20 and stream >> at & 1:
            ones, at = ones + 1, at + 1
        if ones < 20:
            at += 1
            value = ones << k | (stream >> at & ((1 << k) - 1))
            at += k
        else:
            length = (stream >> at & 63) + 1
            at += 6
            value = stream >> at & ((1 << length) - 1)
            at += length
        if at > 8 * len(data):
            raise ValueError("a column is damaged")
        total = total - (total >> 4) + min(value, 1 << (k + 6))
        found.append(value)
        if at > 4096:
            # Shifting a short number is fast, a long one is not.
            stream >>= at & ~7
            data = data[at >> 3:]
            at &= 7
    return found


def polynomial(p, order):
    n = len(p)
    order = min(order, n)
    if order == 0:
        return 0.0
    if order == 1:
        return p[-1]
    if order == 2:
        return 2.0 * p[-1] - p[-2]
    if order == 3:
        return 3.0 * (p[-1] - p[-2]) + p[-3]
    if order == 4:
        return 4.0 * (p[-1] + p[-3]) - 6.0 * p[-2] - p[-4]
    return 5.0 * (p[-1] - p[-4]) + 10.0 * (p[-3] - p[-2]) + p[-5]


def integral(p, first, second, h):
    n = len(p)
    if n == 0:
        return 0.0
    trapeze = p[-1] + 0.5 * h * (first[n - 1] + first[n])
    if second is None:
        return trapeze
    return trapeze - h * h / 12.0 * (second[n] - second[n - 1])


def column_values(column, count, columns, h):
    """All values of a column; `columns` are those that came before, by field and element."""
    field, element, how = column.field, column.element, column.predictor
    codes = rests(column.rests, column.coded) + [0] * (count - column.coded)
    values = []
    if field in WHOLE:
        for code in codes:
            rest = code >> 1 ^ -(code & 1)
            order = min(how, len(values))
            guess = 0 if order == 0 else values[-1] if order == 1 else 2 * values[-1] - values[-2]
            values.append(signed(guess + rest & MASK))
        return values
    single = field == JERK
    first = second = None
    if how == 6:
        zeros = [0.0] * count
        names = DERIVATIVES[field]
        first = columns.get((names[0], element), zeros)
        second = None if names[1] is None else columns.get((names[1], element), zeros)
    for code in codes:
        rest = code >> 1 ^ -(code & 1)
        guess = integral(values, first, second, h) if how == 6 else polynomial(values, how)
        if not math.isfinite(guess):
            guess = values[-1] if values else 0.0
        values.append(number(ordered(guess, single) + rest, single))
    return values


def batch(message, axes):
    """The cycles of one message of `/cycles`."""
    count, h, columns = message.count, message.period_ns * 1e-9, {}
    for column in message.column:
        if column.field in NAMES:
            columns[column.field, column.element] = column_values(column, count, columns, h)
    for i in range(count):
        cycle = SimpleNamespace(sequence=message.start_sequence + i, due_time_ns=message.due_time_ns + i * message.period_ns)
        for field, name in NAMES.items():
            nothing = math.nan if field in ABSENT else 0 if field in WHOLE else 0.0
            get = lambda element: columns[field, element][i] if (field, element) in columns else nothing
            setattr(cycle, name, [get(n) for n in range(axes)] if field in PER_AXIS else get(0))
        yield cycle


def cycles(path):
    """Every cycle of a trace in order. Lists are in the order of the machine's axes."""
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        topics = {channel.topic: channel for channel in summary.channels.values()}
        counts = summary.statistics.channel_message_counts
        in_columns = "/cycles" in topics and counts.get(topics["/cycles"].id, 0) > 0
        topic = "/cycles" if in_columns else "/cycle"
        for _, channel, _, message in reader.iter_decoded_messages(topics=[topic], log_time_order=False):
            if in_columns:
                yield from batch(message, len(channel.metadata["axes"]))
            else:
                yield message


if __name__ == "__main__":
    found, last = 0, None
    for last in cycles(sys.argv[1]):
        found += 1
    print(found, "cycles; the last:", last)
