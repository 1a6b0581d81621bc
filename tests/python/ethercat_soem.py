"""SOEM (pysoem) as MainDevice of the simulated ring: coupler, drive, 8 inputs, 8 outputs, 2 analog inputs.

Usage: ethercat_soem.py INTERFACE
"""

import struct
import sys
import time

import pysoem

PERIOD_S = 0.001
TURN = 1 << 20


def check(what, found, expected):
    if found != expected:
        sys.exit(f"{what}: {found!r} instead of {expected!r}")


def aborted(action):
    try:
        action()
    except pysoem.SdoError as error:
        return error.abort_code
    return None


def remap(position):
    """In PRE-OP: fewer entries than by default, in another order."""
    drive = master.slaves[position]
    for pdo, assignment, entries in (
        (0x1600, 0x1C12, (0x60400010, 0x60600008, 0x607A0020)),
        (0x1A00, 0x1C13, (0x60410010, 0x60610008, 0x60640020, 0x60F40020, 0x603F0010)),
    ):
        drive.sdo_write(assignment, 0, b"\0")
        drive.sdo_write(pdo, 0, b"\0")
        for place, entry in enumerate(entries, 1):
            drive.sdo_write(pdo, place, struct.pack("<I", entry))
        drive.sdo_write(pdo, 0, bytes([len(entries)]))
        # The assignment by complete access, as a whole.
        drive.sdo_write(assignment, 0, struct.pack("<BxH", 1, pdo), ca=True)
    # An input cannot be an output.
    drive.sdo_write(0x1600, 0, b"\0")
    check("mapping of an input", aborted(lambda: drive.sdo_write(0x1600, 1, struct.pack("<I", 0x60410010))), 0x06040041)
    drive.sdo_write(0x1600, 0, b"\3")


def objects(drive):
    check("identity", drive.sdo_read(0x1018, 2), struct.pack("<I", 0x402))
    check("identity as a whole", drive.sdo_read(0x1018, 0, ca=True)[2:6], struct.pack("<I", 0x4556534D))
    check("device type", drive.sdo_read(0x1000, 0), struct.pack("<I", 0x00020192))
    check("name", drive.sdo_read(0x1008, 0), b"CiA 402 servo drive (test simulator)")
    check("no such object", aborted(lambda: drive.sdo_read(0x5555, 0)), 0x06020000)
    check("no such sub-index", aborted(lambda: drive.sdo_read(0x1018, 9)), 0x06090011)
    check("read only", aborted(lambda: drive.sdo_write(0x6041, 0, b"\0\0")), 0x06010002)
    check("wrong length", aborted(lambda: drive.sdo_write(0x6065, 0, b"\0\0")), 0x06070010)
    drive.sdo_write(0x6065, 0, struct.pack("<I", 5 * TURN))
    check("written and read", drive.sdo_read(0x6065, 0), struct.pack("<I", 5 * TURN))
    check("in segments", drive.sdo_read(0x2000, 0, 400), b"test simulator " * 20)
    note = bytes(range(32, 132)) * 3
    drive.sdo_write(0x2000, 0, note)
    check("written in segments", drive.sdo_read(0x2000, 0, 400), note)
    listed = {entry.index: entry for entry in drive.od}
    check("dictionary", {0x1018, 0x1C12, 0x6040, 0x60F4, 0x60BA} - set(listed), set())
    check("name of an object", listed[0x6040].name, b"Control word")


def exchange(seconds):
    """Process data for a while; the smallest and largest working counter."""
    counters = []
    begin = time.monotonic()
    while True:
        master.send_processdata()
        counters.append(master.receive_processdata(10_000))
        time.sleep(PERIOD_S)
        if time.monotonic() - begin >= seconds:
            return min(counters), max(counters)


def to_operational():
    master.send_processdata()
    master.receive_processdata(10_000)
    master.state = pysoem.OP_STATE
    master.write_state()
    for _ in range(200):
        exchange(0.005)
        if master.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE:
            return
    master.read_state()
    sys.exit(f"OP was not reached: {[(d.name, d.state, hex(d.al_status)) for d in master.slaves]}")


def turn(drive):
    """CSP: switch on, one turn within half a second, off."""
    inputs = lambda: struct.unpack("<HbiiH", bytes(drive.input[:13]))

    def order(control, target):
        drive.output = struct.pack("<Hbi", control, 8, target)

    order(0x06, 0)
    exchange(0.1)
    for control, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        order(control, inputs()[2])
        exchange(0.03)
        check(f"state after {control:#x}", inputs()[0] & 0x6F, state)
    check("mode", inputs()[1], 8)
    start, largest = inputs()[2], 0
    begin = time.monotonic()
    while (passed := time.monotonic() - begin) < 0.5:
        order(0x0F, start + int(TURN * passed / 0.5))
        exchange(0)
        largest = max(largest, abs(inputs()[3]))
    order(0x0F, start + TURN)
    exchange(0.3)
    if abs(inputs()[2] - start - TURN) > TURN // 1000:
        sys.exit(f"the drive has not turned once: from {start} to {inputs()[2]}")
    if not TURN / 200 < largest < TURN / 5:
        sys.exit(f"a following error of {largest} increments is none of a motor")
    order(0x06, inputs()[2])
    exchange(0.05)
    check("switched off", inputs()[0] & 0x6F, 0x21)


master = pysoem.Master()
master.open(sys.argv[1])
check("devices", master.config_init(), 5)
check("names", [device.name for device in master.slaves],
      ["SIM-EK1100", "SIM-DRIVE", "SIM-EL1008", "SIM-EL2008", "SIM-EL3102"])
coupler, drive, inputs, outputs, analog = master.slaves
drive.config_func = remap
objects(drive)
master.config_map()
check("sizes", [(len(device.output), len(device.input)) for device in master.slaves],
      [(0, 0), (7, 13), (0, 1), (1, 0), (0, 8)])
check("clocks", master.config_dc(), True)
drive.dc_sync(True, 1_000_000)
check("SAFE-OP", master.state_check(pysoem.SAFEOP_STATE, 500_000), pysoem.SAFEOP_STATE)
to_operational()
check("working counter", exchange(0.2), (master.expected_wkc, master.expected_wkc))
turn(drive)
# Outputs and inputs of terminals; the test has set inputs to A5h and channel 2 to -1234.
outputs.output = b"\x5A"
exchange(0.05)
check("digital inputs", bytes(inputs.input), b"\xA5")
check("analog input", struct.unpack("<HhHh", bytes(analog.input))[3], -1234)
print("outputs are set", flush=True)
# Nothing is sent for longer than the watchdog allows.
time.sleep(0.3)
master.read_state()
check("after the watchdog", (drive.state, drive.al_status), (pysoem.SAFEOP_STATE + pysoem.STATE_ERROR, 0x1B))
check("outputs after the watchdog", outputs.al_status, 0x1B)
for device in (drive, outputs):
    device.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
    device.write_state()
    exchange(0.05)
    check("acknowledged", device.state_check(pysoem.SAFEOP_STATE, 50_000), pysoem.SAFEOP_STATE)
to_operational()
master.state = pysoem.INIT_STATE
master.write_state()
check("INIT", master.state_check(pysoem.INIT_STATE, 500_000), pysoem.INIT_STATE)
master.close()
print("all is well")
