"""Looks at `evolvent top` on a pseudo-terminal, as somebody before a screen would.

    watch_screen.py ROWS COLUMNS END COMMAND...

Starts the command on a terminal of that size, waits until it has drawn a machine's axes, ends it by END ("q" pressed, or
"int": an interrupt signal), and prints as JSON what was drawn: the rows of the last picture, whether the terminal was
given back (first screen, cursor shown, line mode and echo as before), and the exit code.
"""

import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from fcntl import ioctl

PATIENCE_S = 30.0


def main() -> None:
    rows, columns, end, *command = sys.argv[1:]
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", int(rows), int(columns), 0, 0))
    before = termios.tcgetattr(theirs)
    child = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE)
    seen, asked, until = b"", False, time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        ready, _, _ = select.select([ours], [], [], 0.1)
        if ready:
            seen += os.read(ours, 65536)
        elif child.poll() is not None:
            break
        # A whole picture: another one has begun behind it.
        plain = re.sub(rb"\x1b\[[0-9]*m", b"", seen)
        if not asked and re.search(rb"X\*.*\x1b\[H", plain, re.DOTALL):
            asked = True
            if end == "q":
                os.write(ours, b"q")
            else:
                child.send_signal(signal.SIGINT)
    if child.poll() is None:
        child.kill()
    text = re.sub(r"\x1b\[[0-9]*m", "", seen.decode("utf-8", "replace"))
    raw = termios.tcgetattr(theirs)
    pictures = [part for part in text.split("\x1b[H") if "X*" in part]
    last = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", pictures[-1]) if pictures else ""
    print(
        json.dumps(
            {
                "rows": re.split(r"\r*\n", last),
                "first_screen": text.rstrip().endswith("\x1b[?25h\x1b[?1049l"),
                "second_screen": text.startswith("\x1b[?1049h\x1b[?25l"),
                "modes_as_before": raw == before,
                "code": child.wait(),
                "error": child.stderr.read().decode("utf-8", "replace"),
            }
        )
    )


main()
