#!/usr/bin/env python3
"""Writes tests/programs/relief.ngc: a dense three-axis finishing program.

    python3 tools/relief.py > tests/programs/relief.ngc

A surface of three smooth hills and a ripple is scanned in parallel passes along X, forth and back, with a ball
of 3 mm radius (the tool's centre line is offset along the surface normal). The points of a pass are
irregularly spaced, as a CAM system's are: dense where the surface curves, sparse where it is flat, so that
segments are between 0.05 and 1.5 mm long. No random numbers: the output is the same everywhere.
"""

import math

WIDTH, HEIGHT = 60.0, 40.0  # mm, about the work zero in the middle
STEP_OVER = 1.25  # mm between passes
CHORD = 0.004  # mm, chord error of the segments
BALL = 3.0  # mm, radius of the tool
HILLS = [(-14.0, -6.0, 6.0, 9.0), (10.0, 7.0, 4.5, 6.0), (20.0, -11.0, 3.0, 4.0)]  # x, y, height, width


def surface(x, y):
    """Height of the surface and its slopes along X and Y."""
    z = 0.25 * math.sin(0.7 * x) * math.cos(0.5 * y)
    dx = 0.175 * math.cos(0.7 * x) * math.cos(0.5 * y)
    dy = -0.125 * math.sin(0.7 * x) * math.sin(0.5 * y)
    for cx, cy, height, width in HILLS:
        hill = height * math.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (width * width))
        z += hill
        dx -= 2.0 * (x - cx) / (width * width) * hill
        dy -= 2.0 * (y - cy) / (width * width) * hill
    return z, dx, dy


def tool(x, y):
    """Tip of the ball that touches the surface at x, y; Z 0 is the top of the blank, 10 mm above the base."""
    z, dx, dy = surface(x, y)
    norm = math.sqrt(1.0 + dx * dx + dy * dy)
    return x - BALL * dx / norm, y - BALL * dy / norm, z + BALL / norm - BALL - 10.0


def spacing(x, y):
    """Length of a chord that is CHORD off, from the second difference of the path."""
    h = 0.05
    a, b, c = (tool(x + d, y) for d in (-h, 0.0, h))
    bend = math.dist((0, 0, 0), [(p - 2 * q + r) / (h * h) for p, q, r in zip(a, b, c)])
    return min(1.5, max(0.08, math.sqrt(8.0 * CHORD / max(bend, 1e-6))))


def run():
    print("(Relief: parallel finishing passes over three hills)")
    print("(made by tools/relief.py; ball mill 6 mm; work zero in the middle of the blank's top)")
    print("G17 G21 G40 G49 G54 G80 G90 G94")
    print("G64 P0.01")
    print("T4 M6")
    print("S18000 M3")
    print("M8")
    passes = int(HEIGHT / STEP_OVER) + 1
    for count in range(passes):
        y = -HEIGHT / 2.0 + count * STEP_OVER
        xs, x = [], -WIDTH / 2.0
        while x < WIDTH / 2.0:
            xs.append(x)
            x += spacing(x, y)
        xs.append(WIDTH / 2.0)
        if count % 2:
            xs.reverse()
        points = [tool(x, y) for x in xs]
        px, py, pz = points[0]
        if count == 0:
            print("G0 Z5")
            print(f"G0 X{px:.4f} Y{py:.4f}")
            print(f"G1 Z{pz:.4f} F300")
        else:
            print(f"X{px:.4f} Y{py:.4f} Z{pz:.4f}")
        for index, (px, py, pz) in enumerate(points[1:]):
            feed = " F2400" if index == 0 and count == 0 else ""
            print(f"X{px:.4f} Y{py:.4f} Z{pz:.4f}{feed}")
    print("G0 Z5")
    print("M9")
    print("M5")
    print("G0 X0 Y0 Z0")
    print("M30")


if __name__ == "__main__":
    run()
