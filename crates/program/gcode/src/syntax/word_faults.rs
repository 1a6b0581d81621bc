//! Errors about words.

use evolvent_path::{AXES, AxisLetter};

use crate::Code;
use crate::codes::modal_groups::{Group, Motion};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::syntax::statement::{Statement, WORDS, bit, letter_at};

impl Statement {
    #[cold]
    pub(crate) fn unused(&self, unused: u32) -> Fault {
        let first = (0..WORDS)
            .map(letter_at)
            .filter(|letter| unused & bit(*letter) != 0)
            .min_by_key(|letter| self.span(*letter).start)
            .unwrap_or(b'A');
        let name = char::from(first);
        let message = format!("nothing on this line uses {name}");
        let fault = Fault::new(Code::UnusedWord, self.span(first), message);
        if first == b'Q' && self.motion_code() == Some(Motion::QuadraticSpline) {
            let message = "G5.1 Q: G5.1 is a quadratic spline in this dialect, not a switch for look-ahead";
            return Fault::new(Code::UnusedWord, self.motion_span(), message)
                .help("remove the line: look-ahead is always on; G64 P.. sets the tolerance at corners");
        }
        match first {
            b'E' => fault.help(
                "numbers have no exponent: write all digits; the word E belongs to G76, M66, M67 and M68",
            ),
            b'I' | b'J' | b'K' => fault.help(format!(
                "{name} belongs to G2, G3, G2.2, G3.2, G5, G33, G76 or G87"
            )),
            b'R' => fault.help("R belongs to arcs, G10, M19, G76 and the cycles G73 to G89"),
            b'P' => fault.help(
                "P belongs to G2, G3, G4, G5, G10, G64, G76, G82, G86, G88, G89 and M codes with a number",
            ),
            b'Q' => fault.help("Q belongs to G5, G33, G64, G73, G76, G83, M19, M61, M66, M67 and M68"),
            b'L' => fault.help("L belongs to G10, G41.1, G42.1, the cycles G73 to G89, M66 and M98"),
            b'H' => fault.help("H belongs to G43, G43.2 and G76"),
            b'D' => fault.help("D belongs to G41, G42, G76 and G96"),
            _ => fault,
        }
    }
}

#[cold]
pub(crate) fn no_such_axis(name: char, span: Span, axes: &[bool; AXES]) -> Fault {
    let message = format!("{name}: this machine has no such axis");
    let present: String = AxisLetter::ALL
        .iter()
        .filter(|axis| axes[axis.index()])
        .map(|axis| axis.letter())
        .collect();
    Fault::new(Code::NoSuchAxis, span, message).help(format!("its axes are {present}"))
}

#[cold]
pub(crate) fn two_codes_of_group(group: Group, span: Span, mut message: String) -> Fault {
    message.push_str(" are both ");
    message.push_str(group.name());
    Fault::new(Code::ModalGroup, span, message)
        .help("one code per group and line: write them on two lines, or remove one")
}

#[cold]
pub(crate) fn negative(letter: char, value: f64, span: Span) -> Fault {
    Fault::new(Code::Negative, span, format!("{letter}{value} is negative"))
}

/// A non-negative integer. As in LinuxCNC a rounding error of 1e-4 is accepted.
pub(crate) fn integer(value: f64, name: char, span: Span) -> Result<u32, Fault> {
    let rounded = value.round();
    if (value - rounded).abs() > 1e-4 {
        return Err(Fault::new(
            Code::NotInteger,
            span,
            format!("{name}{value}: {name} must be an integer"),
        ));
    }
    if rounded < 0.0 {
        return Err(negative(name, value, span));
    }
    // The parser rejects numbers beyond 1e9, so this fits.
    Ok(rounded as u32)
}
