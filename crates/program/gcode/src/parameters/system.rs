//! Predefined named parameters: read-only views of the modal state.

/// Declares the names in alphabetical order.
macro_rules! systems {
    ($($name:ident = $text:literal,)+) => {
        /// A predefined parameter.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum System {
            $($name,)+
        }

        const TABLE: &[(&str, System)] = &[$(($text, System::$name),)+];
    };
}

systems! {
    A = "_a",
    AbsA = "_abs_a",
    AbsB = "_abs_b",
    AbsC = "_abs_c",
    AbsU = "_abs_u",
    AbsV = "_abs_v",
    AbsW = "_abs_w",
    AbsX = "_abs_x",
    AbsY = "_abs_y",
    AbsZ = "_abs_z",
    Absolute = "_absolute",
    AdaptiveFeed = "_adaptive_feed",
    B = "_b",
    C = "_c",
    CallLevel = "_call_level",
    CutterCompensation = "_ccomp",
    Coordinates = "_coord_system",
    CurrentPocket = "_current_pocket",
    CurrentTool = "_current_tool",
    Feed = "_feed",
    FeedHold = "_feed_hold",
    FeedOverride = "_feed_override",
    Flood = "_flood",
    CentreAbsolute = "_ijk_absolute_mode",
    Imperial = "_imperial",
    Incremental = "_incremental",
    InverseTime = "_inverse_time",
    LatheDiameter = "_lathe_diameter_mode",
    LatheRadius = "_lathe_radius_mode",
    Line = "_line",
    Metric = "_metric",
    Mist = "_mist",
    MotionMode = "_motion_mode",
    Plane = "_plane",
    RemapLevel = "_remap_level",
    RetractOldZ = "_retract_old_z",
    RetractRPlane = "_retract_r_plane",
    Rpm = "_rpm",
    SelectedPocket = "_selected_pocket",
    SelectedTool = "_selected_tool",
    SpeedOverride = "_speed_override",
    SpindleConstantSurface = "_spindle_css_mode",
    SpindleClockwise = "_spindle_cw",
    SpindleOn = "_spindle_on",
    SpindleRpmMode = "_spindle_rpm_mode",
    Task = "_task",
    ToolOffset = "_tool_offset",
    U = "_u",
    UnitsPerMinute = "_units_per_minute",
    UnitsPerRevolution = "_units_per_rev",
    V = "_v",
    Value = "_value",
    ValueReturned = "_value_returned",
    VersionMajor = "_vmajor",
    VersionMinor = "_vminor",
    W = "_w",
    X = "_x",
    Y = "_y",
    Z = "_z",
}

impl System {
    /// The parameter with this name in lower case.
    pub(crate) fn of(name: &str) -> Option<Self> {
        if !name.starts_with('_') {
            return None;
        }
        let index = TABLE.binary_search_by(|(text, _)| (*text).cmp(name)).ok()?;
        Some(TABLE[index].1)
    }

    /// The axis index of `_x` and similar names.
    pub(crate) fn axis(self) -> Option<usize> {
        use System::{A, B, C, U, V, W, X, Y, Z};
        [X, Y, Z, A, B, C, U, V, W].iter().position(|axis| *axis == self)
    }

    /// The axis index of `_abs_x` and similar names.
    pub(crate) fn machine_axis(self) -> Option<usize> {
        use System::{AbsA, AbsB, AbsC, AbsU, AbsV, AbsW, AbsX, AbsY, AbsZ};
        [AbsX, AbsY, AbsZ, AbsA, AbsB, AbsC, AbsU, AbsV, AbsW]
            .iter()
            .position(|axis| *axis == self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found() {
        for (text, system) in TABLE {
            assert_eq!(System::of(text), Some(*system), "{text}: the table is not sorted");
        }
        assert_eq!(System::of("_no_such"), None);
        assert_eq!(System::of("line"), None);
    }
}
