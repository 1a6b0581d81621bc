"""A real core behind the page, for tests and while the page is worked on: status, samples and commands of `evolvent serve` by WebSocket.

Loopback only, without tokens, leases between pages or limits: no screen for a machine.

    python3 core.py --machine-name mill-3axis --machine FILE [--bus-prefix PREFIX] --evolvent BINARY --programs FOLDER --state FOLDER [--page FOLDER] [--port N]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import re
import struct
import subprocess
import sys
import time
import tomllib
from array import array
from pathlib import Path
from typing import Any

from aiohttp import WSMsgType, web

sys.path.insert(0, str(Path(__file__).resolve().parents[5] / "tools/python"))
import evolvent_bus as bus  # noqa: E402

AXES = "XYZABCUVW"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; worker-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
LISTS = {
    "state": "idle running holding held stopping stopped dwell program_stop fault done".split(),
    "mode": "auto manual mdi".split(),
    "machine_state": "estop off on".split(),
    "activity": "none program mdi jog homing".split(),
    "job_result": "none done stopped failed fault".split(),
    "tool_change": "none operator program".split(),
}


def text(field: Any, length: int) -> str:
    return bytes(field[:length]).decode(errors="replace")


def status_to_dict(status: Any) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, _kind in status._fields_:
        if name.startswith("reserved") or name in ("interface_version", "struct_size") or name.endswith("_length"):
            continue
        value = getattr(status, name)
        if name in LISTS:
            value = LISTS[name][value]
        elif name in ("program", "message"):
            value = text(value, getattr(status, name + "_length"))
        elif name == "alarm_text":
            value = text(value, status.alarm_text_length)
        elif not isinstance(value, (int, float)):
            value = list(value)
        result[name] = value
    result["alarms"] = result["alarms"][: min(16, status.alarm_count)]
    result["modal"] = [code for code in result["modal"] if code]
    return result


class Core:
    """One client of the bus, for all pages."""

    def __init__(self, name: str, prefix: str | None) -> None:
        import iceoryx2 as iox2

        self.status_reader = bus.open_status(name, prefix, 30.0)
        self.setpoints = bus.open_setpoints(name, prefix, 30.0)
        node = bus.open_node(name, prefix, 30.0)
        service = iox2.ServiceName.new(f"evolvent/{name}/control")
        self.node = node
        self.service = node.service_builder(service).request_response(bus.ControlRequest, bus.ControlAnswer).open()
        self.client = self.service.client_builder().create()
        self.number = random.getrandbits(63) | 1
        self.serial = 0
        self.lock = asyncio.Lock()

    def request(self, message: dict[str, Any]) -> Any:
        request = bus.ControlRequest(command=message["command"])
        for key in ("axes_mask", "index", "amount"):
            if key in message:
                setattr(request, key, message[key])
        for axis, value in message.get("values", {}).items():
            request.values[int(axis)] = value
        encoded = message.get("text", "").encode()[:1024]
        request.text[: len(encoded)] = encoded
        request.text_length = len(encoded)
        self.serial += 1
        request.client, request.serial = self.number, self.serial
        return self.client.send_copy(request)

    async def answer(self, pending: Any) -> dict[str, Any]:
        end = time.monotonic() + 12
        while time.monotonic() < end:
            response = pending.receive()
            if response is not None:
                answer = bus.ControlAnswer.from_buffer_copy(response.payload().contents)
                response.delete()
                return {"accepted": answer.verdict == 0, "alarm": answer.alarm, "text": text(answer.text, answer.text_length)}
            await asyncio.sleep(0.001)
        return {"accepted": False, "alarm": 0, "text": "no answer"}


class Server:
    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.core = Core(arguments.machine_name, arguments.bus_prefix)
        self.pages: set[web.WebSocketResponse] = set()
        self.holder: web.WebSocketResponse | None = None
        self.program: dict[str, Any] | None = None
        self.last: dict[str, Any] | None = None
        self.fresh_page = False
        with open(arguments.machine, "rb") as file:
            self.file = tomllib.load(file)

    def machine(self) -> dict[str, Any]:
        homed = {table["axis"] for table in self.file.get("homing", [])}
        axes = []
        for axis in self.file["axis"]:
            unit = "deg" if axis["letter"] in "ABC" else "mm"
            axes.append(
                {
                    "letter": axis["letter"],
                    "kind": "rotary" if unit == "deg" else "linear",
                    "min": axis[f"travel_min_{unit}"],
                    "max": axis[f"travel_max_{unit}"],
                    "max_velocity": axis.get(f"max_velocity_{unit}_min", 60 * axis.get(f"max_velocity_{unit}_s", 0)) / 60,
                    "has_home_switch": axis["letter"] in homed,
                }
            )
        return {"name": self.file["name"], "description": self.file.get("description", ""), "kind": self.file["kind"], "axes": axes}

    async def page(self, request: web.Request) -> web.StreamResponse:
        path = (Path(self.arguments.page) / (request.match_info["path"] or "index.html")).resolve()
        if not path.is_file() or Path(self.arguments.page).resolve() not in path.parents:
            raise web.HTTPNotFound
        return web.FileResponse(path, headers={"Content-Security-Policy": POLICY, "Cache-Control": "no-store"})

    async def put(self, request: web.Request) -> web.Response:
        target = Path(self.arguments.programs) / os.path.basename(request.match_info["name"])
        with open(target, "wb") as file:
            async for chunk in request.content.iter_chunked(1 << 20):
                file.write(chunk)
        pending = self.core.request({"command": bus.COMMAND_LOAD, "text": str(target)})
        answer = await self.core.answer(pending)
        # What is wrong with a program is shown with all its places; START judges it again.
        if answer["accepted"] or answer["alarm"] in (919, 923):
            answer = {"accepted": True, "alarm": 0, "text": ""}
            self.program = {"name": target.name, "bytes": target.stat().st_size, "errors": [], "warnings": [], "checked": False, "planned_s": None}
            await self.tell({"type": "program", "program": self.program})
            asyncio.create_task(self.check(target))
        return web.json_response(answer)

    async def check(self, target: Path) -> None:
        async def run(*words: str) -> Any:
            process = await asyncio.create_subprocess_exec(
                self.arguments.evolvent, *words, str(target), "--machine", self.arguments.machine, "--json",
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )
            output, _ = await process.communicate()
            try:
                return json.loads(output)
            except ValueError:
                return {}

        checked = await run("check")
        program = dict(self.program or {}, checked=True, errors=checked.get("errors", []), warnings=checked.get("warnings", []))
        self.program = program
        await self.tell({"type": "program", "program": program})
        planned = await run("plan")
        self.program = dict(program, planned_s=planned.get("duration_s"))
        await self.tell({"type": "program", "program": self.program})

    async def text(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(Path(self.arguments.programs) / os.path.basename(request.match_info["name"]))

    async def path(self, request: web.Request) -> web.StreamResponse:
        """Chunks of the planned path: a count (u32), x y z (f32) of each vertex, feed in mm/s (f32, negative: rapid), line (u32)."""
        name = os.path.basename(request.match_info["name"])
        table = Path(self.arguments.programs) / f"{name}.csv"
        kept = Path(self.arguments.state) / "parameters.var"
        process = await asyncio.create_subprocess_exec(
            self.arguments.evolvent, "plan", *(["--parameters", str(kept)] if kept.exists() else []), str(Path(self.arguments.programs) / name), "--machine", self.arguments.machine,
            "--setpoints", str(table), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        response = web.StreamResponse(headers={"Content-Type": "application/octet-stream"})
        await response.prepare(request)
        if await process.wait() == 0:
            source = (Path(self.arguments.programs) / name).read_text(errors="replace").splitlines()
            rapid = [re.match(r"\s*(N\d+\s*)?G0*0(\D|$)", text_line) is not None for text_line in ["", *source]]
            with open(table) as file:
                columns = {name: i for i, name in enumerate(next(file).strip().split(","))}
                axes = [columns.get(f"{letter}_mm") for letter in "XYZ"]
                position, feed, line = array("f"), array("f"), array("I")

                async def flush() -> None:
                    await response.write(struct.pack("<I", len(feed)) + position.tobytes() + feed.tobytes() + line.tobytes())

                for number, text_line in enumerate(file):
                    if number % 8:
                        continue
                    row = text_line.split(",")
                    position.extend(float(row[i]) if i is not None else 0.0 for i in axes)
                    line.append(int(row[columns["line"]]))
                    speed = float(row[columns["feed_mm_s"]])
                    feed.append(-speed if line[-1] < len(rapid) and rapid[line[-1]] else speed)
                    if len(feed) == 16384:
                        await flush()
                        del position[:], feed[:], line[:]
                await flush()
        await response.write_eof()
        return response

    async def tell(self, message: dict[str, Any]) -> None:
        line = json.dumps(message)
        for page in list(self.pages):
            try:
                await page.send_str(line)
            except (ConnectionError, RuntimeError):
                pass

    async def leases(self) -> None:
        for page in list(self.pages):
            holder = None if self.holder is None else "a page"
            try:
                await page.send_str(json.dumps({"type": "lease", "mine": page is self.holder, "holder": holder, "read_only": False}))
            except (ConnectionError, RuntimeError):
                self.pages.discard(page)

    async def socket(self, request: web.Request) -> web.StreamResponse:
        page = web.WebSocketResponse(max_msg_size=1 << 16)
        await page.prepare(request)
        self.pages.add(page)
        await page.send_str(json.dumps({"type": "machine", "machine": self.machine(), "version": "test"}))
        await page.send_str(json.dumps({"type": "program", "program": self.program}))
        await self.leases()
        self.fresh_page = True
        async for message in page:
            if message.type != WSMsgType.TEXT:
                continue
            asyncio.create_task(self.hear(page, json.loads(message.data)))
        self.pages.discard(page)
        if self.holder is page:
            self.holder = None
            await self.leases()
        return page

    async def hear(self, page: web.WebSocketResponse, message: dict[str, Any]) -> None:
        kind = message["type"]
        stops = (bus.COMMAND_ESTOP, bus.COMMAND_STOP, bus.COMMAND_JOG_STOP)
        if kind == "take" and (self.holder is None or message["force"]):
            self.holder = page
            await self.leases()
        elif kind == "give" and self.holder is page:
            self.holder = None
            await self.leases()
        elif kind == "keep" and self.holder is page:
            self.core.request({"command": bus.COMMAND_JOG_KEEP})
        elif kind == "command":
            if self.holder is not page and message["command"] not in stops:
                answer = {"accepted": False, "alarm": 0, "text": "another page is in control"}
            elif message["command"] in stops:
                answer = await self.core.answer(self.core.request(message))
            else:
                async with self.core.lock:
                    answer = await self.core.answer(self.core.request(message))
            await page.send_str(json.dumps({"type": "answer", "id": message["id"], **answer}))

    def kept(self) -> dict[str, Any]:
        """Offsets and tools as the core keeps them, lists in the order of the machine's axes."""
        letters = [axis["letter"] for axis in self.file["axis"]]
        parameters: dict[int, float] = {}
        tools = []
        folder = Path(self.arguments.state)
        if (folder / "parameters.var").exists():
            for line in (folder / "parameters.var").read_text().splitlines():
                words = line.split()
                if len(words) >= 2 and words[0].isdigit():
                    parameters[int(words[0])] = float(words[1])
        if (folder / "tools.tbl").exists():
            for line in (folder / "tools.tbl").read_text().splitlines():
                fields, _, comment = line.partition(";")
                words = {word[0]: word[1:] for word in fields.split()}
                if words.get("T"):
                    offsets = [float(words.get(letter, 0)) for letter in letters]
                    tools.append({"number": int(words["T"]), "offsets": offsets, "diameter": float(words.get("D", 0)), "comment": comment.strip()})
        offsets = [
            {"system": n, "values": [parameters.get(5201 + 20 * n + AXES.index(letter), 0.0) for letter in letters]} for n in range(1, 10)
        ]
        return {"type": "kept", "offsets": offsets, "tools": tools}

    async def watch_kept(self) -> None:
        told = None
        while True:
            kept = self.kept()
            if kept != told or self.fresh_page:
                told, self.fresh_page = kept, False
                await self.tell(kept)
            await asyncio.sleep(0.3)

    async def watch(self) -> None:
        fresh = time.monotonic()
        while True:
            status = None
            while (next_status := self.core.status_reader.receive()) is not None:
                status = next_status
            samples = []
            while (setpoint := self.core.setpoints.receive()) is not None:
                samples.append(setpoint)
            if status is not None:
                fresh, self.last = time.monotonic(), status_to_dict(status)
            if self.last is not None and (status is not None or samples):
                if samples:
                    newest = samples[-1]
                    self.last["position_machine"] = list(newest.position)
                    self.last["time_ns"] = newest.due_time_ns
                    offset = zip(newest.position, self.last["work_offset"], self.last["tool_offset"])
                    self.last["position_work"] = [p - w - t for p, w, t in offset]
                    packed = pack(samples)
                    for page in list(self.pages):
                        try:
                            await page.send_bytes(packed)
                        except (ConnectionError, RuntimeError):
                            self.pages.discard(page)
                await self.tell({"type": "status", "status": self.last})
            if time.monotonic() - fresh > 0.5:
                await self.tell({"type": "core", "alive": False})
            await asyncio.sleep(1 / 60)


def pack(samples: list[Any]) -> bytes:
    """Little-endian: a sample has time (f64), line and 0 (u32), feed (f64), then position, velocity and acceleration of nine axes (f32)."""
    return b"".join(
        struct.pack("<dIId27f", s.due_time_ns * 1e-9, s.line, 0, s.feed_mm_s, *s.position, *s.velocity, *s.acceleration) for s in samples
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("machine-name", "machine", "bus-prefix", "evolvent", "programs", "state"):
        parser.add_argument(f"--{name}", required=name != "bus-prefix")
    parser.add_argument("--page", default=str(Path(__file__).resolve().parents[1] / "dist"))
    parser.add_argument("--port", type=int, default=0)
    arguments = parser.parse_args()

    async def run() -> None:
        server = Server(arguments)
        app = web.Application(client_max_size=1 << 28)
        app.router.add_get("/ws", server.socket)
        app.router.add_put("/programs/{name}", server.put)
        app.router.add_get("/programs/{name}", server.text)
        app.router.add_get("/path/{name}", server.path)
        app.router.add_get("/{path:.*}", server.page)
        runner = web.AppRunner(app, access_log=None)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", arguments.port)
        await site.start()
        print(f"http://127.0.0.1:{site._server.sockets[0].getsockname()[1]}/", flush=True)
        keeping = asyncio.create_task(server.watch_kept())
        await asyncio.gather(server.watch(), keeping)

    asyncio.run(run())


if __name__ == "__main__":
    main()
