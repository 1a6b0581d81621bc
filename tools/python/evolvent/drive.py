"""CiA 402: which state a status word tells."""

from __future__ import annotations

import enum
from typing import Optional


class DriveState(enum.Enum):
    """States of a drive's state machine."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08

    @staticmethod
    def decode(status_word: int) -> Optional[DriveState]:
        """The state that object 6041h tells; None where its bits fit no state."""
        for state, mask in STATUS_WORDS.items():
            if status_word & mask == state.value:
                return state
        return None


STATUS_WORDS: dict[DriveState, int] = {
    DriveState.NOT_READY_TO_SWITCH_ON: 0x4F,
    DriveState.SWITCH_ON_DISABLED: 0x4F,
    DriveState.READY_TO_SWITCH_ON: 0x6F,
    DriveState.SWITCHED_ON: 0x6F,
    DriveState.OPERATION_ENABLED: 0x6F,
    DriveState.QUICK_STOP_ACTIVE: 0x6F,
    DriveState.FAULT_REACTION_ACTIVE: 0x4F,
    DriveState.FAULT: 0x4F,
}
"""The mask that is laid over a status word for each state; what is left is the state's value."""
