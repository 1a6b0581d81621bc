"""Drive bridges in Python: setpoints in, feedback out.

    bridge = evolvent.Bridge("mill-3axis")
    for setpoint in bridge.setpoints():
        ...
    bridge.answer(feedback)

`Bridge` owns the two channels, `Queue` keeps setpoints until they are due, `DriveState` reads status words. The messages
themselves, with their fields and constants, are in `evolvent_bus`.
"""

from .bridge import Bridge, Queue, monotonic_ns
from .drive import STATUS_WORDS, DriveState

__all__ = ["Bridge", "DriveState", "Queue", "STATUS_WORDS", "monotonic_ns"]
