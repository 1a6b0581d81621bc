"""Compares holds with the shortest stop on the same path by another method. Reads the lines of the example `holds`:

    cargo run --release -p evolvent-runtime --example holds -- PROGRAM MACHINE 4000 20 1 | python shortest_stop.py

With `--csv` it writes rows of `../tests/shortest_stops.csv` instead, which a test compares with.

Needs numpy and scipy. With b = s^2, s the rate of plan time tau, an axis has the acceleration b q'' + b' q'/2, linear in b, and the
jerk sqrt(b) (b q''' + 3/2 b' q'' + b'' q'/2). The bound J/sqrt(b) is convex, so its tangent lies below it: each linear program is
an inner approximation, and a sequence of them leads to the shortest stop that ends at a given tau. The last part, below the rate SE,
is the closed form. Limits are kept to 1 % at three instants per cell of 0.35 ms. The method starts from the driven motion, and where
that fails from a smooth fall of the rate.
"""

import json
import math
import sys

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_matrix

FACTOR, EXTRA_S = 1.15, 0.015  # the bound: at rest within FACTOR x the minimum + EXTRA_S
JERK = 1.002  # what the core may have of the jerk limit
SE = 0.06
CELL_S = 0.00035
SLACK = 0.01


def axis_to_rest(v, a, most, jerk):
    """Minimum time of one axis from velocity v and acceleration a to rest, wherever that is."""
    if v + a * abs(a) / (2 * jerk) < 0:
        v, a = -v, -a
    peak = math.sqrt(max(jerk * v + 0.5 * a * a, 0.0))
    if peak <= most:
        return (a + 2 * peak) / jerk
    return (a + 2 * most) / jerk + (v + 0.5 * a * a / jerk - most * most / jerk) / most


class Plan:
    def __init__(self, hold):
        self.step = hold["sample_s"]
        self.v, self.a, self.j = (np.array(hold[key]) for key in "vaj")
        self.most_a, self.most_j = np.array(hold["acceleration"]), np.array(hold["jerk"])

    def at(self, tau):
        """Velocity, acceleration and jerk: cubic in the first two, linear in jerk."""
        x = np.clip(tau / self.step, 0, len(self.v) - 1.000001)
        k = x.astype(int)
        t, h = (x - k)[:, None], self.step
        left, right = 1 + t * t * (2 * t - 3), t * t * (3 - 2 * t)
        out, into = t * (1 - t) ** 2 * h, -t * t * (1 - t) * h
        cubic = lambda f, d: left * f[k] + right * f[k + 1] + out * d[k] + into * d[k + 1]
        return cubic(self.v, self.a), cubic(self.a, self.j), (1 - t) * self.j[k] + t * self.j[k + 1]


def driven(hold, plan):
    """Time, plan time and rate of the driven motion, from its velocities."""
    period, v = hold["period_s"], np.array(hold["driven_v"])
    tau, rate = np.zeros(len(v)), np.ones(len(v))
    for k in range(1, len(v)):
        tau[k] = tau[k - 1] + period * rate[k - 1]
        for _ in range(3):
            q = plan.at(tau[k : k + 1])[0][0]
            square = q @ q
            # Where the plan nearly rests the rate cannot be seen.
            rate[k] = np.clip(v[k] @ q / square, 0, 1) if square > 4 else rate[k - 1]
            tau[k] = tau[k - 1] + 0.5 * period * (rate[k - 1] + rate[k])
    return np.arange(len(v)) * period, tau, rate


def shortest(plan, knots, guess, rounds=14):
    """The shortest stop whose rate is SE at the last knot, s; None where none is found."""
    cells, h = len(knots) - 1, np.diff(knots)
    part = np.array([0.02, 0.5, 0.98])
    cell, part = (x.ravel() for x in np.meshgrid(np.arange(cells), part, indexing="ij"))
    tau = knots[cell] + part * h[cell]
    v, a, j = plan.at(tau)
    most_a, most_j = np.maximum(plan.most_a, abs(a)), np.maximum(plan.most_j * JERK, abs(j))
    end = abs(plan.at(knots[-1:])[0][0])
    # The closed form at the end leaves out s^2 q'' and 3 s s' q''.
    end_a = 0.93 / max((end / plan.most_a).max(), 1e-12)
    end_j = 0.93 / max((end / plan.most_j).max(), 1e-12)
    steepest = min(math.sqrt(2 * SE * end_j), end_a)
    # Unknowns: b and b' at the knots, b'' in the cells, a slack for each instant; derivatives scaled by the mean cell.
    scale, count = h.mean(), len(cell)
    first, second, slack = cells + 1, 2 * cells + 2, 3 * cells + 2
    g = h / scale
    k = np.arange(cells)
    rows = np.concatenate([np.repeat(2 * k, 4), np.repeat(2 * k + 1, 3), 2 * cells + np.arange(3)])
    one = np.ones(cells)
    columns = np.concatenate(
        [
            np.stack([k + 1, k, first + k, second + k], 1).ravel(),
            np.stack([first + k + 1, first + k, second + k], 1).ravel(),
            [0, first, cells],
        ]
    )
    values = np.concatenate(
        [np.stack([one, -one, -g, -g * g / 2], 1).ravel(), np.stack([one, -one, -g], 1).ravel(), [1, 1, 1]]
    )
    total = slack + 6 * count
    equal = coo_matrix((values, (rows, columns)), shape=(2 * cells + 3, total)).tocsr()
    equal_to = np.zeros(2 * cells + 3)
    equal_to[-3], equal_to[-1] = 1, SE * SE
    floor = SE * SE * 0.5
    bounds = [(floor, 1.0)] * (cells + 1) + [(None, 0.02)] * cells + [(-2 * steepest * scale, 0)]
    bounds += [(None, None)] * cells + [(0, None)] * (6 * count)
    b, best, last = np.maximum(guess, floor), None, None
    f = part * h[cell] / scale
    for step in range(rounds):
        here = np.maximum(np.interp(tau, knots, b), 0.6 * floor)
        root, tangent = np.sqrt(here), 0.5 / here
        row, column, value, most = [], [], [], []
        for axis in range(3):
            q, q2, q3 = v[:, axis], a[:, axis], j[:, axis]
            for kind in range(2):
                if kind == 0:
                    of = (q2 / most_a[:, axis], 0.5 * q / most_a[:, axis] / scale, 0 * q)
                    line, limit = 0 * tangent, 1.0
                else:
                    per = root / most_j[:, axis]
                    of = (q3 * per, 1.5 * q2 * per / scale, 0.5 * q * per / scale**2)
                    line, limit = tangent, 1.5
                for sign in (1, -1):
                    r = len(most) * count + np.arange(count)
                    zero, one_, two = (sign * x for x in of)
                    zero = zero + line
                    row += [r] * 4
                    column += [cell, first + cell, second + cell, slack + (2 * axis + kind) * count + np.arange(count)]
                    value += [zero, zero * f + one_, zero * f * f / 2 + one_ * f + two, -np.ones(count)]
                    most.append(np.full(count, limit))
        above = coo_matrix(
            (np.concatenate(value), (np.concatenate(row), np.concatenate(column))), shape=(len(most) * count, total)
        ).tocsr()
        cost = np.zeros(total)
        cost[slack:] = 1.0
        weight = np.zeros(cells + 1)
        weight[:-1] += h / 2
        weight[1:] += h / 2
        cost[: cells + 1] = -1.5 * weight / np.maximum(b, SE * SE) ** 1.5
        found = linprog(
            cost, A_ub=above, b_ub=np.concatenate(most), A_eq=equal, b_eq=equal_to, bounds=bounds, method="highs"
        )
        if found.status != 0:
            return None
        b = found.x[: cells + 1]
        slope, bend = found.x[first : first + cells + 1] / scale, found.x[second : second + cells] / scale**2
        over = found.x[slack:].max()
        x = np.linspace(0, 1, 9)[None, :] * h[:, None]
        inside = np.maximum(b[:-1, None] + slope[:-1, None] * x + bend[:, None] * x * x / 2, 1e-6)
        simpson = np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) / 24
        seconds = ((inside**-0.5 * simpson).sum(1) * h).sum() + axis_to_rest(SE, slope[-1] / 2, end_a, end_j)
        if over <= SLACK:
            if best is not None and seconds > best - 2e-5:
                break
            best = seconds if best is None else min(best, seconds)
        if last is not None and over > 0.05 and over > 0.9 * last and step > 3:
            break
        last = over
    return best


def shortest_of(hold):
    """The shortest stop over all places, s; None where none is found."""
    plan = Plan(hold)
    time, tau, rate = driven(hold, plan)
    last = len(rate) - int(np.argmax(rate[::-1] >= SE))
    seconds, distance = time[last], tau[last]
    x = np.linspace(0, 1, max(20, int(seconds / CELL_S)) + 1)
    as_driven = np.interp(x * seconds, time[: last + 1], tau[: last + 1]) / distance
    smooth = 1 - (1 - x) ** 1.8
    starts = [
        (as_driven, np.interp(x * seconds, time[: last + 1], rate[: last + 1]) ** 2),
        (smooth, np.maximum((1 - smooth) ** (4 / 3), SE * SE)),
    ]
    best = None
    for knots, guess in starts:
        for part in (1.12, 1.08, 1.05, 1.02, 1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7):
            found = shortest(plan, knots * distance * part, guess)
            if found is None and best is not None:
                break
            if found is not None:
                best = found if best is None else min(best, found)
        if best is not None:
            break
    return best


def row(hold, least, method):
    """A hold and its minimum, for the table of the test."""
    names = [hold["program"].rsplit("/", 1)[-1], hold["machine"].rsplit("/", 1)[-1]]
    rest = [f"{hold['rate_hz']:.0f}", str(hold["moment"]), str(hold["is_frozen"]).lower()]
    return ",".join(names + rest + [f"{hold['feed_mm_s']:.3f}", f"{least:.5f}", method])


def main():
    as_table = "--csv" in sys.argv[1:]
    ratios, holds, over, unknown = [], 0, 0, 0
    for line in sys.stdin:
        hold = json.loads(line)
        holds += 1
        took = hold["took_s"]
        least = max(
            axis_to_rest(hold["v"][0][i], hold["a"][0][i], hold["acceleration"][i], hold["jerk"][i]) for i in range(3)
        )
        # No stop on any path is shorter than that of an axis by itself.
        if (took - EXTRA_S) / FACTOR <= least:
            if as_table:
                print(row(hold, least, "axis"), flush=True)
            continue
        best = shortest_of(hold)
        if best is None:
            unknown += 1
            if as_table:
                continue
            print(f"line {hold['line']}: {took * 1e3:.1f} ms, no stop found by the other method", flush=True)
            continue
        ratios.append(took / best)
        over += (took - EXTRA_S) / best > FACTOR
        if as_table:
            print(row(hold, best, "path"), flush=True)
            continue
        print(
            f"line {hold['line']}, {hold['feed_mm_s']:.1f} mm/s: {took * 1e3:.1f} ms, other method {best * 1e3:.1f} ms: "
            f"{took / best:.3f}, minus 15 ms {(took - EXTRA_S) / best:.3f}",
            flush=True,
        )
    out = sys.stderr if as_table else sys.stdout
    print(f"{holds} holds, {len(ratios)} compared, {unknown} unknown, {over} above the bound", file=out)
    sys.exit(1 if over else 0)


if __name__ == "__main__":
    main()
