"""KickCAT as MainDevice of the simulated ring: coupler, drive, 8 inputs, 8 outputs, 2 analog inputs.

Usage: ethercat_kickcat.py INTERFACE
"""

import struct
import sys
import time

import kickcat

PARTIAL, COMPLETE = kickcat.Access.PARTIAL, kickcat.Access.COMPLETE


def check(what, found, expected):
    if found != expected:
        sys.exit(f"{what}: {found!r} instead of {expected!r}")


link = kickcat.create_link(sys.argv[1], "")
# The ring is a process among others: an answer may take some ms.
link.set_timeout(0.02)
bus = kickcat.Bus(link)
bus.init(1.0)
check("devices", len(bus.slaves()), 5)
drive, inputs, outputs, analog = bus.slaves()[1:]
check("identity", bus.read_sdo(drive, 0x1018, 2, PARTIAL, 4, 1.0), struct.pack("<I", 0x402))
check("identity as a whole", bus.read_sdo(drive, 0x1018, 0, COMPLETE, 64, 1.0)[2:6], struct.pack("<I", 0x4556534D))
check("name", bus.read_sdo(drive, 0x1008, 0, PARTIAL, 64, 1.0), b"CiA 402 servo drive (test simulator)")
check("name of an object", bus.read_object_description(drive, 0x6040)[0], "Control word")
try:
    sys.exit(f"no such object: {bus.read_sdo(drive, 0x5555, 0, PARTIAL, 4, 0.2)!r}")
except RuntimeError:
    # It waits in vain: it looks for the code of an abort in SDO responses, ETG.1000.6 sends it as an SDO request.
    pass
bus.create_mapping()
check("sizes", [(device.output_size, device.input_size) for device in bus.slaves()],
      [(0, 0), (17, 31), (0, 1), (1, 0), (0, 8)])
bus.request_state(kickcat.State.SAFE_OP)
bus.wait_for_state(kickcat.State.SAFE_OP, 1.0)


def order(control, target):
    # 6040h, 607Ah, 60B1h, 60B2h, 60B8h, 6060h, two gaps of 8 bits.
    drive.set_output_bytes(struct.pack("<HiihHbBB", control, target, 0, 0, 0, 8, 0, 0))


def exchange(seconds):
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        bus.process_data()
        time.sleep(0.001)


def state():
    return struct.unpack_from("<Hi", drive.input_data)


order(0, 0)
outputs.set_output_bytes(b"\x5A")
bus.process_data_no_check()
bus.request_state(kickcat.State.OPERATIONAL)
bus.wait_for_state(kickcat.State.OPERATIONAL, 2.0, bus.process_data_no_check)
exchange(0.1)
for control, expected in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
    order(control, state()[1])
    exchange(0.05)
    check(f"state after {control:#x}", state()[0] & 0x6F, expected)
start = state()[1]
begin = time.monotonic()
while (passed := time.monotonic() - begin) < 0.5:
    order(0x0F, start + int((1 << 20) * passed / 0.5))
    exchange(0)
    bus.process_data()
    time.sleep(0.001)
order(0x0F, start + (1 << 20))
exchange(0.3)
if abs(state()[1] - start - (1 << 20)) > 1000:
    sys.exit(f"the drive has not turned once: from {start} to {state()[1]}")
check("digital inputs", inputs.input_data, b"\xA5")
check("analog input", struct.unpack("<HhHh", analog.input_data)[3], -1234)
print("all is well")
