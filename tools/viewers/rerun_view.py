#!/usr/bin/env python3
"""Shows a trace in Rerun: the path in space, feed and every axis over time.

    pip install rerun-sdk==0.41.0 mcap mcap-protobuf-support
    tools/viewers/rerun_view.py run.mcap                opens the viewer
    tools/viewers/rerun_view.py run.mcap --save run.rrd writes a recording instead

`rerun run.mcap` opens a trace as well, message by message; this lays it out. Both ways of recording cycles are read.
"""

import argparse
import os
import sys

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "python"))
import evolvent_trace  # noqa: E402

QUANTITIES = ["position", "velocity", "acceleration", "jerk"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trace")
    parser.add_argument("--save", metavar="FILE.rrd", help="write a recording instead of opening the viewer")
    arguments = parser.parse_args()

    sequences, times, feeds, values = [], [], [], {name: [] for name in QUANTITIES}
    for cycle in evolvent_trace.cycles(arguments.trace):
        sequences.append(cycle.sequence)
        times.append(cycle.due_time_ns)
        feeds.append(cycle.feed_mm_s)
        for name in QUANTITIES:
            values[name].append(list(getattr(cycle, name)))
    if not times:
        sys.exit("the trace holds no cycles")

    axes = len(values["position"][0])
    blueprint = rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="/path", name="path"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="/feed", name="feed, mm/s"),
                *(rrb.TimeSeriesView(origin=f"/{name}", name=name) for name in QUANTITIES[1:]),
            ),
        )
    )
    rr.init("evolvent", spawn=arguments.save is None, default_blueprint=blueprint)
    if arguments.save:
        rr.save(arguments.save, default_blueprint=blueprint)

    index = [
        rr.TimeColumn("cycle", sequence=sequences),
        rr.TimeColumn("time", timestamp=np.array(times, dtype="datetime64[ns]")),
    ]
    rr.send_columns("/feed", index, rr.Scalars.columns(scalars=feeds))
    for name in QUANTITIES:
        table = np.array(values[name])
        for axis in range(axes):
            rr.send_columns(f"/{name}/{axis}", index, rr.Scalars.columns(scalars=table[:, axis]))
    places = np.zeros((len(times), 3))
    places[:, : min(axes, 3)] = np.array(values["position"])[:, :3]
    rr.log("/path", rr.LineStrips3D([places]), static=True)
    print(f"{len(times)} cycles of {axes} axes")


if __name__ == "__main__":
    main()
