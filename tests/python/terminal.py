"""Plays somebody at a terminal: terminal.py STEPS COMMAND... prints what was on the screen and how the command ended, as JSON.

STEPS is a JSON list: ["see", TEXT] waits for a text behind those seen before, ["silent", SECONDS, TEXT] makes sure that a text does
not come so soon, ["type", TEXT] types.
"""

import json
import os
import pty
import select
import sys
import time

PATIENCE_S = 30


class Terminal:
    def __init__(self, command):
        self.screen = ""
        self.seen = 0
        self.is_open = True
        self.child, self.line = pty.fork()
        if self.child == 0:
            os.execvp(command[0], command)

    def read(self, seconds):
        if not self.is_open:
            time.sleep(seconds)
            return
        if select.select([self.line], [], [], seconds)[0]:
            try:
                data = os.read(self.line, 65536)
            except OSError:  # the other end was closed
                data = b""
            self.is_open = bool(data)
            self.screen += data.decode(errors="replace")

    def see(self, text, seconds=PATIENCE_S):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            at = self.screen.find(text, self.seen)
            if at >= 0:
                self.seen = at + len(text)
                return True
            if not self.is_open:
                return False
            self.read(0.05)
        return False

    def close(self):
        while self.is_open:
            self.read(0.1)
        return os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])


def play(steps, command):
    terminal = Terminal(command)
    failed = None
    for step in steps:
        what, *words = step
        if what == "type":
            os.write(terminal.line, words[0].encode())
            good = True
        elif what == "see":
            good = terminal.see(words[0])
        else:
            good = not terminal.see(words[1], words[0])
        if not good:
            failed = step
            os.write(terminal.line, b"\x03")
            break
    code = terminal.close()
    print(json.dumps({"screen": terminal.screen, "code": code, "failed": failed}))


play(json.loads(sys.argv[1]), sys.argv[2:])
