//! The parameters of a program that no file stores, for transfer to another program.

use std::fmt::Write;
use std::io::BufRead;

use crate::interpreter::Interpreter;
use crate::syntax::lexer::MAX_NUMBER;
use crate::tables::parameter_file::PersistentParameters;

/// The numbered parameters that programs use freely.
const PROGRAM_PARAMETERS: std::ops::RangeInclusive<u32> = 1..=5000;
/// Minimum magnitude written as a plain decimal; smaller numbers are long and are written with a power of
/// two.
const MIN_DECIMAL: f64 = 1e-9;
/// Minimum magnitude; smaller numbers are written as 0.
const MIN_MAGNITUDE: f64 = 1e-300;

impl<R: BufRead> Interpreter<R> {
    /// Program lines that set the parameters of this program, up to the line read last, in another program:
    /// #1 to #5000, except those of `persistent`, and named ones. Every value is reproduced bit for bit,
    /// except magnitudes below 1e-300, which become 0. Inside a subroutine its arguments and local names are
    /// not included.
    ///
    /// ```
    /// use evolvent_gcode::{Interpreter, PersistentParameters, Settings};
    ///
    /// let program = "#31 = 5\n#<depth> = -2.5\nM2\n";
    /// let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    /// assert!(interpreter.by_ref().all(|command| command.is_ok()));
    /// let lines = interpreter.volatile_parameters(&PersistentParameters::default());
    /// assert_eq!(lines, "#31=5\n#<depth>=-2.5\n");
    /// ```
    #[must_use]
    pub fn volatile_parameters(&self, persistent: &PersistentParameters) -> String {
        let mut lines = String::new();
        let is_outside = self.parameters.depth() == 0;
        let mut write_assignment = |name: std::fmt::Arguments<'_>, value: f64| {
            if value.is_finite() {
                // Writing to a string cannot fail.
                let _ = writeln!(lines, "{name}={}", Literal(value));
            }
        };
        for number in PROGRAM_PARAMETERS {
            let value = self.parameters.numbered(number as usize);
            let is_argument = number <= 30 && !is_outside;
            if value != 0.0 && !is_argument && persistent.get(number).is_none() {
                write_assignment(format_args!("#{number}"), value);
            }
        }
        for (name, value) in self.parameters.all_named() {
            if is_outside || name.starts_with('_') {
                write_assignment(format_args!("#<{name}>"), value);
            }
        }
        lines
    }
}

/// A number as a program can write it: without an exponent, and at most 1e9.
struct Literal(f64);

impl std::fmt::Display for Literal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (value, size) = (self.0, self.0.abs());
        if size < MIN_MAGNITUDE {
            return write!(f, "0");
        }
        if (MIN_DECIMAL..=MAX_NUMBER).contains(&size) {
            return write!(f, "{value}");
        }
        // Powers of two are exact, and so are products and quotients with them. The logarithm of the largest
        // numbers rounds to 1024, so the mantissa is from 2 to 4.
        let power = size.log2().floor() as i32 - 1;
        let (high, low) = (power / 2, power - power / 2);
        let mantissa = value / 2_f64.powi(high) / 2_f64.powi(low);
        if power > 0 {
            write!(f, "[{mantissa}*[2**{power}]]")
        } else {
            write!(f, "[{mantissa}/[2**{}]]", -power)
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Interpreter, PersistentParameters, Settings};

    fn after(text: &str) -> Interpreter<&[u8]> {
        let mut interpreter = Interpreter::new(text.as_bytes(), Settings::default());
        for command in interpreter.by_ref() {
            command.unwrap();
        }
        interpreter
    }

    #[test]
    fn values_round_trip_bit_for_bit() {
        let mut bits = 0x9E37_79B9_7F4A_7C15_u64;
        let mut next = || {
            bits ^= bits >> 12;
            bits ^= bits << 25;
            bits ^= bits >> 27;
            bits.wrapping_mul(0x2545_F491_4F6C_DD1D)
        };
        let mut values = vec![
            1e9,
            -1e9,
            1.0000001e9,
            1e-9,
            0.99e-9,
            1.0 / 3.0,
            f64::MAX,
            1e-300,
            -0.1,
        ];
        while values.len() < 900 {
            let value = f64::from_bits(next());
            if value.is_finite() && value.abs() >= 1e-300 {
                values.push(value);
            }
        }
        let mut parameters = after("M2\n");
        for (k, value) in values.iter().enumerate() {
            parameters.parameters.set_numbered(100 + k, *value);
        }
        let lines = parameters.volatile_parameters(&PersistentParameters::default());
        let again = after(&lines);
        for (k, value) in values.iter().enumerate() {
            let found = again.parameter(100 + k as u32);
            assert_eq!(
                found.to_bits(),
                value.to_bits(),
                "{value:e} came back as {found:e}"
            );
        }
    }

    #[test]
    fn persistent_and_system_parameters_are_omitted() {
        let persistent = PersistentParameters::parse("77 1\n").unwrap();
        let text = "#1=4 #77=9 #5161=3 #<b>=2 #<a>=0 #<_global>=7 #4999=1\no<s> sub\n\
                    #1=8 #<b>=6 #2=#<_line>\no<s> endsub\no<s> call [5]\n";
        let lines = after(text).volatile_parameters(&persistent);
        assert_eq!(lines, "#1=4\n#4999=1\n#<_global>=7\n#<a>=0\n#<b>=2\n");
        // Ended inside a subroutine.
        let ended_inside = text.replace("o<s> endsub", "M2\no<s> endsub");
        assert_eq!(
            after(&ended_inside).volatile_parameters(&persistent),
            "#4999=1\n#<_global>=7\n"
        );
    }
}
