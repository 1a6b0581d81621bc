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
    /// Stops every axis on its own and removes power from the drives.
    Estop = 1, "ESTOP";
    /// Leaves the emergency stop; the machine is then off.
    EstopReset = 2, "ESTOP_RESET";
    /// Enables the drives.
    On = 3, "ON";
    /// Removes power from the drives.
    Off = 4, "OFF";
    /// Changes the mode: `index`.
    Mode = 5, "MODE";
    /// Loads the program of file `text`.
    Load = 6, "LOAD";
    /// Starts the program, from line `index` if that is above 1.
    Start = 7, "START";
    /// Holds the feed.
    Hold = 8, "HOLD";
    /// Continues after a hold or a program stop.
    Resume = 9, "RESUME";
    /// Runs one block of the program.
    Step = 10, "STEP";
    /// Stops within the limits and ends the job.
    Stop = 11, "STOP";
    /// Clears the alarms and the modes left by programs and MDI.
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
    /// Jogs the axes of `axes_mask`: with `index` 0 in the directions of `values` while it is renewed, with 1
    /// by the distances in `values`. Maximum speed `amount` mm/s or degrees/s, 0 for the jog speed of the
    /// machine.
    Jog = 20, "JOG";
    /// Renews a jog: its client is still there.
    JogKeep = 21, "JOG_KEEP";
    /// Ends the jog.
    JogStop = 22, "JOG_STOP";
    /// Homes the axes of `axes_mask`, all if it is 0.
    Home = 23, "HOME";
    /// Sets the offsets of work coordinate system `index` (1 is G54, 0 the active one) to `values`.
    WorkOffset = 24, "WORK_OFFSET";
    /// Sets the offsets so that the present positions of the axes read `values`.
    TouchOff = 25, "TOUCH_OFF";
    /// Sets tool `index`: offsets `values` of `axes_mask`, diameter `amount`. Index 0 reads the tool table
    /// again.
    Tool = 26, "TOOL";
    /// Clears the alarms.
    ClearAlarms = 27, "CLEAR_ALARMS";
    /// Sets the output named `text` to `amount`; 0 or 1 for a digital output.
    SetOutput = 28, "SET_OUTPUT";
    /// Connects the handwheel to the axis of `axes_mask` (0 for none), `amount` mm or degrees per detent.
    Handwheel = 29, "HANDWHEEL";
    /// Returns to the position at which the held program was left: each jog backwards, at a maximum speed of
    /// `amount` mm/s or degrees/s, 0 for the jog speed of the machine.
    Return = 30, "RETURN";
    /// Drives backwards along the path of the held program to the start of a block: `index` block starts
    /// back, 0 counts as 1.
    Retrace = 31, "RETRACE";
}

impl CommandCode {
    /// The command with this number.
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
