"""Clients of the screen's server in another language than its own, by the published library `websockets`.

    screen_client.py jog URL [--speed MM_S]     jogs X+ and keeps it until it is killed, or cut by a line on stdin
    screen_client.py first URL                  the first jog and the first emergency stop of a service
    screen_client.py rules URL WATCH_URL        leases, numbers of commands, roles, hosts, origins, uploads
    screen_client.py limits URL                 the longest message, and how many come at once and in a second
    screen_client.py certificate URL FILE.pem   an encrypted page with a certificate of somebody else's making
    screen_client.py hostile URL COUNT SEED     mutated messages
    screen_client.py crowd URL PROGRAM CLIENTS SECONDS
                                                that many clients look on, three of them without reading
"""

from __future__ import annotations

import collections
import http.client
import json
import random
import socket
import ssl
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

ESTOP, ESTOP_RESET, ON, MODE, LOAD, START, JOG = 1, 2, 3, 5, 6, 7, 20


class Page:
    """One connection, and what it has heard."""

    def __init__(self, url: str, cookie: str | None = None, origin: str | None = None) -> None:
        parts = urlsplit(url)
        headers = {"Cookie": cookie} if cookie else {}
        self.socket: ClientConnection = connect(
            f"ws://{parts.netloc}{parts.path}ws", origin=origin, additional_headers=headers, max_size=None, compression=None, legacy=True
        )
        self.next = 0
        # The newest status that has come, and messages that came while it was looked for.
        self.seen_ns = 0
        self.waiting: collections.deque[str | bytes] = collections.deque()

    def receive(self, timeout: float) -> str | bytes:
        message = self.socket.recv(timeout=timeout)
        if isinstance(message, str) and message.startswith('{"type":"status"'):
            self.seen_ns = json.loads(message)["status"]["time_ns"]
        return message

    def catch_up(self) -> None:
        """Receives what has come, as a page does that runs."""
        end = time.monotonic() + 10
        while time.monotonic() < end:
            try:
                self.waiting.append(self.receive(timeout=0.002))
            except TimeoutError:
                if self.seen_ns > 0:
                    return

    def hear(self, kind: str, timeout: float = 20.0, **wanted: Any) -> dict[str, Any]:
        end = time.monotonic() + timeout
        while True:
            message = self.waiting.popleft() if self.waiting else self.receive(timeout=max(0.001, end - time.monotonic()))
            if isinstance(message, bytes):
                continue
            found = json.loads(message)
            if found["type"] == kind and all(found.get(key) == value for key, value in wanted.items()):
                return found

    def say(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def take(self, force: bool = False, is_silent: bool = False) -> None:
        self.say(type="take", force=force)
        self.hear("lease", mine=True)
        if not is_silent:
            threading.Thread(target=self.live, daemon=True).start()

    def live(self) -> None:
        """Control is of a page that says that it still runs."""
        try:
            while True:
                self.say(type="alive")
                time.sleep(0.5)
        except ConnectionClosed:
            pass

    def command(self, number: int, identity: int | None = None, seen_ns: int | None = None, **fields: Any) -> dict[str, Any]:
        if seen_ns is None:
            self.catch_up()
            seen_ns = self.seen_ns
        self.next += 1
        identity = self.next if identity is None else identity
        self.say(type="command", id=identity, command=number, seen_ns=seen_ns, **fields)
        return self.hear("answer", id=identity)

    def does(self, number: int, **fields: Any) -> None:
        answer = self.command(number, **fields)
        assert answer["accepted"], answer


def request(url: str, method: str = "GET", path: str = "", body: bytes | None = None, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """One request with headers as they are given; `Host` too."""
    parts = urlsplit(url)
    link = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=30)
    link.putrequest(method, (path if path.startswith("/") else parts.path + path), skip_host="Host" in headers)
    if body is not None:
        link.putheader("Content-Length", str(len(body)))
    for name, value in headers.items():
        link.putheader(name.replace("_", "-"), value)
    link.endheaders(body)
    answer = link.getresponse()
    text = answer.read()
    found = {name.lower(): value for name, value in answer.getheaders()}
    link.close()
    return answer.status, found, text


def cookie_of(url: str) -> str:
    status, headers, _ = request(url)
    assert status == 200, status
    return headers["set-cookie"].split(";")[0]


def jog(url: str, speed: float) -> None:
    page = Page(url)
    page.take()
    ended = threading.Event()

    def keep() -> None:
        while not ended.is_set():
            page.say(type="keep")
            time.sleep(0.025)

    def cut() -> None:
        if sys.stdin.readline():
            # Without a closing handshake: the peer sees a reset.
            page.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
            page.socket.socket.shutdown(socket.SHUT_RDWR)

    threading.Thread(target=cut, daemon=True).start()
    page.does(MODE, index=1)
    page.does(JOG, axes_mask=1, index=0, amount=speed, values={"0": 1.0})
    threading.Thread(target=keep, daemon=True).start()
    print("jogging", flush=True)
    try:
        while True:
            page.socket.recv()
    except ConnectionClosed:
        ended.set()
        time.sleep(600)


def first(url: str) -> None:
    page = Page(url)
    page.take()
    page.does(MODE, index=1)
    page.does(JOG, axes_mask=1, index=0, amount=5.0, values={"0": 1.0})
    page.catch_up()
    begun = time.monotonic()
    page.does(ESTOP, seen_ns=page.seen_ns)
    print(f"ok the first emergency stop was answered after {(time.monotonic() - begun) * 1e3:.1f} ms", flush=True)


def refused_upgrade(url: str, **headers: str) -> int:
    status, _, _ = request(
        url, path="ws", Connection="Upgrade", Upgrade="websocket", Sec_WebSocket_Version="13", Sec_WebSocket_Key="x3JJHMbDL1EzLkh9GBhXDw==", **headers
    )
    return status


def vertices_of(path):
    """Number of vertices of the programmed and of the planned path. A chunk has a header of 12 bytes and 21 bytes per vertex."""
    at, counts, replaced = 0, [0, 0], 0
    while at < len(path):
        number, kind, now_replaced = struct.unpack_from("<III", path, at)
        assert kind == 1 or counts[1] == 0, "the programmed path comes first"
        assert now_replaced >= replaced, (now_replaced, replaced)
        at, replaced = at + 12 + 21 * number, now_replaced
        counts[kind] += number
    assert at == len(path), (at, len(path))
    assert replaced == 0xFFFFFFFF, "in the end all of the programmed path is replaced"
    return counts


def rules(url: str, watch_url: str) -> None:
    port = urlsplit(url).port
    own = f"127.0.0.1:{port}"
    # Hosts, origins, keys.
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}", f"localhost.evil.example:{port}"):
        assert request(url, Host=host)[0] == 403, host
        assert refused_upgrade(url, Host=host) == 403, host
    for origin in ("http://evil.example", "null", f"https://{own}", f"http://localhost:{port}", "file://"):
        assert refused_upgrade(url, Origin=origin) == 403, origin
        try:
            Page(url, origin=origin)
            raise AssertionError(origin)
        except InvalidStatus as refusal:
            assert refusal.response.status_code == 403
    assert refused_upgrade(url, Origin=f"http://{own}") == 101
    for path in ("/", "/ws", "/" + "0" * 32 + "/", "/" + "0" * 32 + "/ws", "/../"):
        assert request(url, path=path)[0] == 404, path
    status, headers, text = request(url)
    policy = headers["content-security-policy"]
    assert status == 200 and b"<script" in text and "default-src 'none'" in policy and "unsafe" not in policy, headers
    assert headers["x-frame-options"] == "DENY" and "HttpOnly" in headers["set-cookie"], headers
    for path in ("..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e/etc/passwd", "programs/..%2fparameters.var", "programs/%2fetc%2fpasswd", "path/..%2ftools.tbl"):
        assert request(url, path=path)[0] == 404, path

    # The lease: one commands, others watch and may stop.
    first, second = Page(url), Page(url)
    first.take()
    assert second.hear("lease")["mine"] is False
    refused = second.command(ESTOP_RESET)
    assert not refused["accepted"] and "control" in refused["text"], refused
    second.say(type="take", force=False)
    assert second.hear("lease")["mine"] is False
    first.does(ESTOP_RESET)
    first.does(ON)
    second.does(ESTOP)
    first.hear("status")
    # A number that was used, and one below, have no effect.
    first.does(ESTOP_RESET)
    for identity in (first.next, 1, 0):
        again = first.command(ON, identity=identity)
        assert not again["accepted"] and "before" in again["text"], again
    # Taken over: told to all, logged, and the former one commands no more.
    second.take(force=True)
    first.hear("lease", mine=False)
    assert not first.command(ON)["accepted"]
    assert any("took control from" in entry["text"] for entry in Page(url).hear("log")["entries"])
    # What was sent on a link that was dead for a while is refused, unless it stops.
    second.catch_up()
    for seen_ns in (second.seen_ns - 5_000_000_000, 0):
        late = second.command(ON, seen_ns=seen_ns)
        assert not late["accepted"] and "out of date" in late["text"], late
    assert second.command(ESTOP, seen_ns=0)["accepted"]
    second.does(ESTOP_RESET)
    # A page that has control and says nothing for 3 s loses it.
    second.say(type="give")
    # Other connections may be served before this is done.
    second.hear("lease", holder=None)
    silent, onlooker = Page(url), Page(url)
    # Before its last word: the server's wait begins with that.
    begun = time.monotonic()
    silent.take(is_silent=True)
    while onlooker.hear("lease")["holder"] is None:
        pass
    onlooker.hear("lease", timeout=20, holder=None)
    assert time.monotonic() - begun > 2.0, time.monotonic() - begun
    assert not silent.command(ON)["accepted"]
    assert any("sent nothing for 3 s" in entry["text"] for entry in Page(url).hear("log")["entries"])
    second.take()
    # A connection that is gone has given its lease back, and a new one begins with none.
    second.socket.close()
    third = Page(url)
    assert third.hear("lease", holder=None)["mine"] is False
    assert not third.command(ON)["accepted"]

    # Who has the other key watches only, whatever it sends.
    watcher = Page(watch_url)
    assert watcher.hear("lease")["read_only"] is True
    watcher.say(type="take", force=True)
    for command in (ON, ESTOP, JOG):
        answer = watcher.command(command)
        assert not answer["accepted"] and "watch" in answer["text"], answer

    # Uploads: of the page in control only, with names that are no paths.
    cookie = cookie_of(url)
    page, tab = Page(url, cookie), Page(url, cookie)
    mine, other = (str(each.hear("lease")["page"]) for each in (page, tab))
    program = b"G21 G90 G94\nG1 X5 F600\nM2\n"
    assert request(url, "PUT", "programs/a.ngc", program, Cookie=cookie, Evolvent_Page=mine)[0] == 403
    page.take()
    assert request(url, "PUT", "programs/a.ngc", program, Evolvent_Page=mine)[0] == 403
    # Another tab of the same browser has the same cookie.
    assert request(url, "PUT", "programs/a.ngc", program, Cookie=cookie, Evolvent_Page=other)[0] == 403
    assert request(url, "PUT", "programs/a.ngc", program, Cookie=cookie)[0] == 403
    assert request(watch_url, "PUT", "programs/a.ngc", program, Cookie=cookie, Evolvent_Page=mine)[0] == 403
    assert request(url, "PUT", "programs/a.ngc", program, Cookie=cookie, Evolvent_Page=mine, Origin="http://evil.example")[0] == 403
    for name in ("..%2fa.ngc", ".hidden", "a%00b", "x" * 120):
        assert request(url, "PUT", f"programs/{name}", program, Cookie=cookie, Evolvent_Page=mine)[0] in (400, 404), name
    status, _, text = request(url, "PUT", "programs/a.ngc", program, Cookie=cookie, Evolvent_Page=mine)
    assert status == 200 and json.loads(text)["accepted"], text
    loaded = page.hear("program")
    while not (loaded["program"] and loaded["program"]["checked"]):
        loaded = page.hear("program")
    assert loaded["program"]["name"] == "a.ngc" and loaded["program"]["errors"] == [], loaded
    assert request(url, path="programs/a.ngc")[2] == program
    path = request(url, path="path/a.ngc")[2]
    programmed, planned = vertices_of(path)
    assert programmed == 2 and planned > 2, (programmed, planned)
    # How it would begin in the middle, and traces: nothing but what is in their folders.
    status, _, text = request(url, path="restart/a.ngc/2")
    assert status == 200 and json.loads(text)["line"] == 2 and "G1" in json.loads(text)["modes"], text
    outside = ("restart/..%2fparameters.var/2", "traces/..%2f..%2fetc%2fpasswd/data", "traces/..%2fparameters.var/report", "traces/parameters.var/data", "chatter")
    for path in (*outside, "comparison/..%2fa/0/..%2fb/0"):
        assert request(url, path=path)[0] == 404, path
    assert request(url, path="traces", Host="evil.example")[0] == 403
    traces = json.loads(request(watch_url, path="traces")[2])
    assert len(traces) == 1 and traces[0]["is_open"], traces
    status, headers, text = request(url, path=f"traces/{traces[0]['name']}/report")
    assert status == 200 and b"verdict" in text, text
    assert "sandbox allow-scripts;" in headers["content-security-policy"] + ";" and "frame-ancestors 'self'" in headers["content-security-policy"], headers
    assert headers["x-frame-options"] == "SAMEORIGIN", headers
    parts = urlsplit(url)
    # A connection that closes behind its body, at any moment of what follows: the program is loaded, told and stored all the same.
    comments = b"(%s)\n" % (b"x" * 76) * 100_000
    for trial in range(8):
        name = f"closed-{trial}.ngc"
        link = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=60)
        link.request("PUT", parts.path + f"programs/{name}", comments + program, {"Cookie": cookie, "Evolvent-Page": mine})
        time.sleep(0.01 * trial)
        link.close()
        told = page.hear("program")
        while not (told["program"] and told["program"]["name"] == name):
            told = page.hear("program")
        # What the core rejects next removes nothing of it.
        status, _, text = request(url, "PUT", "programs/bad.ngc", b"G1 X9999 F1\nM2\n", Cookie=cookie, Evolvent_Page=mine)
        assert status == 200, text
        file = Path(told["program"]["file"])
        assert file.stat().st_size == len(comments + program), file
        remains = [other.name for other in file.parents[1].iterdir() if other.name.startswith(".upload-")]
        assert remains == [], remains
    # More than a program may have ends the upload.
    link = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=60)
    link.putrequest("PUT", parts.path + "programs/large.ngc")
    link.putheader("Content-Length", str(300 << 20))
    link.putheader("Cookie", cookie)
    link.putheader("Evolvent-Page", mine)
    link.endheaders()
    try:
        for _ in range(300):
            link.send(b"(" + b"x" * ((1 << 20) - 3) + b")\n")
        assert link.getresponse().status == 413
    except (BrokenPipeError, ConnectionResetError):
        pass
    assert request(url, path="programs/large.ngc")[0] == 404
    print("ok", flush=True)


MESSAGES = [
    '{"type":"keep"}',
    '{"type":"take","force":true}',
    '{"type":"give"}',
    '{"type":"command","id":7,"command":20,"index":0,"amount":12.5,"axes_mask":2,"values":{"1":-1}}',
    '{"type":"command","id":8,"command":6,"text":"part.ngc"}',
    '{"type":"command","id":9,"command":16,"amount":0.5}',
]
PIECES = ["null", "1e999", "-1", "18446744073709551616", "[[[[", "{}", '"\\ud800"', "\0", "NaN", "9" * 400, "../../etc/passwd", "\u202e", '"type":', "é" * 700]


def mutated(source: random.Random) -> str | bytes:
    text = list(source.choice(MESSAGES))
    for _ in range(source.randint(1, 6)):
        at = source.randrange(len(text) + 1)
        match source.randrange(4):
            case 0:
                text[at : at + source.randint(1, 8)] = []
            case 1:
                text.insert(at, source.choice(PIECES))
            case 2:
                text[at : at + 1] = [chr(source.choice([source.randrange(32, 127), source.randrange(0xD7FF)]))]
            case _:
                text[at:at] = text[at : at + 20] * source.randint(1, 40)
    line = "".join(text)
    return line.encode()[:-1] if source.random() < 0.1 else line


def hostile(url: str, count: int, seed: int) -> None:
    source = random.Random(seed)
    sent = broken = 0
    while sent < count:
        try:
            page = Page(url)
            with page.socket:
                for _ in range(min(350, count - sent)):
                    page.socket.send(mutated(source))
                    sent += 1
                page.say(type="give")
        except ConnectionClosed:
            broken += 1
    # Bytes that are no WebSocket and no HTTP.
    parts = urlsplit(url)
    for _ in range(200):
        with socket.create_connection((parts.hostname, parts.port)) as raw:
            raw.sendall(source.randbytes(source.randint(1, 4000)))
    page = Page(url)
    page.hear("status")
    page.take(force=True)
    print(f"ok {sent} messages, {broken} connections closed by the server", flush=True)


def limits(url: str) -> None:
    def still_there(page: Page) -> None:
        page.say(type="reboot")
        assert "unknown message" in page.hear("answer", id=0)["text"]

    def until_closed(page: Page) -> None:
        end = time.monotonic() + 60
        try:
            while time.monotonic() < end:
                page.receive(timeout=60)
        except ConnectionClosed:
            return
        raise AssertionError("the server keeps the connection")

    longest = '{"type":"alive"' + " " * (16384 - 16) + "}"
    assert len(longest) == 16384
    page = Page(url)
    page.socket.send(longest)
    still_there(page)
    page.socket.send(longest + " ")
    until_closed(page)

    # 400 at once, and 200 more after each second.
    page = Page(url)
    for count in (390, 190):
        for _ in range(count):
            page.say(type="alive")
        still_there(page)
        time.sleep(1.0)
    # More than that, as fast as they go: what a minute and a half would permit.
    flood = Page(url)
    number = flood.hear("lease")["page"]
    sent = 0
    try:
        for _ in range(20_000):
            flood.say(type="alive")
            sent += 1
    except ConnectionClosed:
        pass
    until_closed(flood)
    entries = Page(url).hear("log")["entries"]
    assert any(entry["fact"] == {"code": "too_many_messages", "page": number} for entry in entries), entries
    still_there(page)
    print(f"ok the server ended a flood of {sent} messages", flush=True)


def certificate(url: str, file: str) -> None:
    assert url.startswith("https://"), url
    parts = urlsplit(url)

    def status(context: ssl.SSLContext) -> tuple[int, bytes | None]:
        link = http.client.HTTPSConnection(parts.hostname or "", parts.port, timeout=30, context=context)
        link.request("GET", parts.path)
        shown = link.sock.getpeercert(binary_form=True)
        answer = link.getresponse()
        answer.read()
        link.close()
        return answer.status, shown

    code, shown = status(ssl.create_default_context(cafile=file))
    assert code == 200 and shown == ssl.PEM_cert_to_DER_cert(Path(file).read_text()), code
    try:
        status(ssl.create_default_context())
        raise AssertionError("who does not trust the certificate reaches the page")
    except ssl.SSLCertVerificationError:
        pass
    # Without encryption nothing is said.
    try:
        code = request(url.replace("https://", "http://"))[0]
        raise AssertionError(f"an answer without encryption: {code}")
    except (http.client.BadStatusLine, ConnectionResetError):
        pass
    print("ok", flush=True)


def crowd(url: str, program: str, clients: int, seconds: float) -> None:
    cookie = cookie_of(url)
    page = Page(url, cookie)
    mine = str(page.hear("lease")["page"])
    page.take()
    status, _, text = request(url, "PUT", "programs/crowd.ngc", program.encode(), Cookie=cookie, Evolvent_Page=mine)
    assert status == 200 and json.loads(text)["accepted"], text
    found = page.hear("program", timeout=60)
    while not (found["program"] and found["program"]["checked"]):
        found = page.hear("program", timeout=60)
    page.does(MODE, index=0)
    # By the name in the status, as a page does: nothing starts that somebody else has loaded meanwhile.
    page.does(START, text=page.hear("status")["status"]["program"])
    # Some that never read. Their window is small, so that the server feels it soon.
    lazy = []
    for _ in range(3):
        parts = urlsplit(url)
        raw = socket.socket()
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        raw.connect((parts.hostname, parts.port))
        upgrade = f"GET {parts.path}ws HTTP/1.1\r\nHost: {parts.netloc}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        raw.sendall((upgrade + "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\n\r\n").encode())
        lazy.append(raw)
    frames, gaps = [0] * clients, [0.0] * clients

    def look(index: int) -> None:
        own = Page(url)
        own.hear("status")
        end = last = time.monotonic()
        end += seconds
        while last < end:
            own.hear("status", timeout=10)
            now = time.monotonic()
            frames[index] += 1
            gaps[index] = max(gaps[index], now - last)
            last = now

    threads = [threading.Thread(target=look, args=(index,)) for index in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(json.dumps({"least_frames": min(frames), "most_frames": max(frames), "longest_gap_s": max(gaps), "lazy": len(lazy)}), flush=True)


def main(words: list[str]) -> None:
    match words:
        case ["jog", url, *rest]:
            jog(url, float(rest[1]) if rest else 20.0)
        case ["first", url]:
            first(url)
        case ["rules", url, watch_url]:
            rules(url, watch_url)
        case ["limits", url]:
            limits(url)
        case ["certificate", url, file]:
            certificate(url, file)
        case ["hostile", url, count, seed]:
            hostile(url, int(count), int(seed))
        case ["crowd", url, program, clients, seconds]:
            crowd(url, program, int(clients), float(seconds))
        case _:
            sys.exit(__doc__)


main(sys.argv[1:])
