//! The nine axes of RS274/NGC and vectors over them.

/// Number of axes carried along every path: X Y Z A B C U V W.
pub const AXES: usize = 9;

/// One number per axis in the order X Y Z A B C U V W.
///
/// Linear axes (XYZ, UVW) are in millimetres, rotary axes (ABC) in degrees. Coordinates keep the unit of
/// their axis from program to bus: nothing between them needs the sine of a rotary axis.
pub type Axes = nalgebra::SVector<f64, AXES>;

/// An axis, identified by its letter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum AxisLetter {
    /// First linear axis.
    X,
    /// Second linear axis.
    Y,
    /// Third linear axis; on a mill parallel to the spindle.
    Z,
    /// Rotary axis about X.
    A,
    /// Rotary axis about Y.
    B,
    /// Rotary axis about Z.
    C,
    /// Linear axis parallel to X.
    U,
    /// Linear axis parallel to Y.
    V,
    /// Linear axis parallel to Z.
    W,
}

impl AxisLetter {
    /// All axes in order.
    pub const ALL: [Self; AXES] = [
        Self::X,
        Self::Y,
        Self::Z,
        Self::A,
        Self::B,
        Self::C,
        Self::U,
        Self::V,
        Self::W,
    ];

    /// Index into [`Axes`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The upper-case letter.
    #[must_use]
    pub const fn letter(self) -> char {
        b"XYZABCUVW"[self as usize] as char
    }

    /// The letter of the axis with this index, or `?` if there is none: for messages about received data.
    ///
    /// ```
    /// assert_eq!(evolvent_path::AxisLetter::letter_of(4), 'B');
    /// assert_eq!(evolvent_path::AxisLetter::letter_of(9), '?');
    /// ```
    #[must_use]
    pub fn letter_of(index: usize) -> char {
        Self::ALL.get(index).map_or('?', |axis| axis.letter())
    }

    /// The axis with this letter in either case, or `None`.
    ///
    /// ```
    /// use evolvent_path::AxisLetter;
    ///
    /// assert_eq!(AxisLetter::from_letter('b').map(AxisLetter::index), Some(4));
    /// assert_eq!(AxisLetter::from_letter('E'), None);
    /// ```
    #[must_use]
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|axis| axis.letter() == letter.to_ascii_uppercase())
    }

    /// Whether this is a rotary axis, with coordinates in degrees.
    #[must_use]
    pub const fn is_rotary(self) -> bool {
        matches!(self, Self::A | Self::B | Self::C)
    }
}
