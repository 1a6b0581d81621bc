//! The commands by their numbers on the bus.

macro_rules! codes {
    ($($(#[doc = $doc:literal])* $name:ident = $number:literal, $text:literal;)*) => {
        /// The number of a command on the bus.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u32)]
        pub enum CommandCode {
            $($(#[doc = $doc])* $name = $number,)*
        }

        impl CommandCode {
            /// All commands in order of their numbers, which begin with 1.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The name in the bus's bindings.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

codes! {
    /// Every axis stops by itself, the drives lose power.
    Estop = 1, "ESTOP";
    /// Leaves the emergency stop: off.
    EstopReset = 2, "ESTOP_RESET";
    /// Enables the drives.
    On = 3, "ON";
    /// Takes power from the drives.
    Off = 4, "OFF";
    /// Changes the mode: `index`.
    Mode = 5, "MODE";
    /// Loads the program of file `text`.
    Load = 6, "LOAD";
    /// Starts the program, from line `index` if that is above 1.
    Start = 7, "START";
    /// Holds the feed.
    Hold = 8, "HOLD";
    /// Goes on after a hold or a program stop.
    Resume = 9, "RESUME";
    /// Runs one block of the program.
    Step = 10, "STEP";
    /// Stops within the limits and ends the job.
    Stop = 11, "STOP";
    /// Forgets the modes that programs and MDI have left, and clears the alarms.
    Reset = 12, "RESET";
    /// Single step on or off: `index`.
    SingleStep = 13, "SINGLE_STEP";
    /// Optional stop on or off: `index`.
    OptionalStop = 14, "OPTIONAL_STOP";
    /// Block delete on or off: `index`.
    BlockDelete = 15, "BLOCK_DELETE";
    /// Feed override: `amount`, 0 to 2.
    FeedOverride = 16, "FEED_OVERRIDE";
    /// Rapid override: `amount`, 0 to 1.
    RapidOverride = 17, "RAPID_OVERRIDE";
    /// Spindle override: `amount`, 0 to 2.
    SpindleOverride = 18, "SPINDLE_OVERRIDE";
    /// Executes the block `text`.
    Mdi = 19, "MDI";
    /// Jogs the axes of `axes_mask`: with `index` 0 in the directions of `values` as long as it is kept, with
    /// 1 by the distances in `values`; at `amount` mm/s or degrees/s at most, 0 for the machine's own speed.
    Jog = 20, "JOG";
    /// The client that jogs is still there.
    JogKeep = 21, "JOG_KEEP";
    /// Ends the jog.
    JogStop = 22, "JOG_STOP";
    /// Homes the axes of `axes_mask`, all if it is 0.
    Home = 23, "HOME";
    /// Sets the offsets of work coordinate system `index` (1 is G54, 0 the active one) to `values`.
    WorkOffset = 24, "WORK_OFFSET";
    /// Sets them so that the axes' present positions read `values`.
    TouchOff = 25, "TOUCH_OFF";
    /// Sets tool `index`: offsets `values` of `axes_mask`, diameter `amount`. With index 0 the tool table is
    /// read again.
    Tool = 26, "TOOL";
    /// Clears the alarms.
    ClearAlarms = 27, "CLEAR_ALARMS";
    /// Sets the output of the name `text` to `amount`: 0 or 1 of a digital one.
    SetOutput = 28, "SET_OUTPUT";
    /// The handwheel moves the axis of `axes_mask`, none with 0, by `amount` mm or degrees a detent.
    Handwheel = 29, "HANDWHEEL";
    /// Drives back to where the held program was left: each jog backwards at `amount` mm/s or degrees/s at
    /// most, 0 for the machine's own speed.
    Return = 30, "RETURN";
    /// Drives backwards along the path of the held program to the start of a block: `index` starts back, 0 as
    /// 1.
    Retrace = 31, "RETRACE";
}

impl CommandCode {
    /// The command of a number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get((number as usize).checked_sub(1)?).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_names_stand_in_order() {
        for (index, &code) in CommandCode::ALL.iter().enumerate() {
            assert_eq!(code as usize, index + 1);
            assert_eq!(CommandCode::from_number(code as u32), Some(code));
        }
        assert_eq!(CommandCode::from_number(0), None);
        assert_eq!(CommandCode::from_number(u32::MAX), None);
    }
}
