//! Persistent parameters in LinuxCNC's file format: number and value on each line.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::BufRead;
use std::path::Path;

use evolvent_path::{AXES, Axes, AxisMask};

use crate::parameters::values::{G92, G92_ACTIVE, HOME_G28, HOME_G30, NUMBERED, WORK_OFFSET, WORK_OFFSET_1};
use crate::state::rotation::{rotate, rotate_back, rotation_of};
use crate::tables::store::{read_text, replace_file};
use crate::{Interpreter, Settings, StoreError, WORK_OFFSETS};

/// Maximum magnitude of a stored value, as for a number in a program.
const MAX_VALUE: f64 = 1e9;

/// The reason why a text is not a parameter file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParameterFileError {
    /// A line is not a number and a value.
    #[error(
        "line {line}: \"{text}\" is not a parameter number with a value; write lines such as 5221 12.5, \
         values within 1e9"
    )]
    Line {
        /// Line, from 1.
        line: usize,
        /// As written.
        text: String,
    },
    /// The parameter does not exist.
    #[error("line {line}: parameter {number} does not exist; numbers are 1 to {}", NUMBERED - 1)]
    Number {
        /// Line, from 1.
        line: usize,
        /// As written.
        number: u32,
    },
    /// A parameter occurs twice.
    #[error("line {line}: parameter {number} occurs twice; keep one of the lines")]
    Twice {
        /// Line, from 1.
        line: usize,
        /// The parameter.
        number: u32,
    },
}

/// Numbered parameters that persist from run to run: those in the file, and always the positions of G28 and
/// G30, the offset of G92 and the work offsets. Lengths in mm, angles in degrees.
///
/// ```no_run
/// use evolvent_gcode::{Interpreter, PersistentParameters, Settings};
/// # fn main() -> Result<(), evolvent_gcode::StoreError> {
/// # let (program, file) = (&b""[..], std::path::Path::new("mill.var"));
/// let mut persistent = PersistentParameters::load(file)?;
/// let mut settings = Settings::default();
/// persistent.apply(&mut settings);
/// let mut interpreter = Interpreter::new(program, settings);
/// // ... all commands ...
/// persistent.update(&interpreter);
/// persistent.save(file)?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct PersistentParameters {
    values: BTreeMap<u32, f64>,
}

impl Default for PersistentParameters {
    /// Everything at 0, G54 active.
    fn default() -> Self {
        let mut values = BTreeMap::new();
        let mut row = |first: usize, count: usize| {
            values.extend((first..first + count).map(|number| (number as u32, 0.0)));
        };
        row(HOME_G28, AXES);
        row(HOME_G30, AXES);
        row(G92_ACTIVE, 1 + AXES);
        row(WORK_OFFSET, 1);
        for index in 0..WORK_OFFSETS {
            row(WORK_OFFSET_1 + 20 * index, AXES + 1);
        }
        values.insert(WORK_OFFSET as u32, 1.0);
        Self { values }
    }
}

impl PersistentParameters {
    /// Parses a text: lines of number and value, in any order; empty lines and text after `;` are skipped.
    ///
    /// # Errors
    /// The first invalid line.
    pub fn parse(text: &str) -> Result<Self, ParameterFileError> {
        let mut persistent = Self::default();
        let mut seen = std::collections::BTreeSet::new();
        for (index, content) in text.lines().enumerate() {
            let line = index + 1;
            let content = content.split(';').next().unwrap_or_default().trim();
            if content.is_empty() {
                continue;
            }
            let mut words = content.split_whitespace();
            let number = words.next().and_then(|word| word.parse::<u32>().ok());
            let value = words
                .next()
                .and_then(|word| word.parse::<f64>().ok())
                .filter(|value| value.is_finite() && value.abs() <= MAX_VALUE);
            let (Some(number), Some(value), None) = (number, value, words.next()) else {
                let text = content.chars().take(60).collect();
                return Err(ParameterFileError::Line { line, text });
            };
            if !(1..NUMBERED as u32).contains(&number) {
                return Err(ParameterFileError::Number { line, number });
            }
            if !seen.insert(number) {
                return Err(ParameterFileError::Twice { line, number });
            }
            persistent.values.insert(number, value);
        }
        Ok(persistent)
    }

    /// Reads a file. A file that does not exist yet gives [`PersistentParameters::default`].
    ///
    /// # Errors
    /// [`StoreError`] if the file cannot be read or is invalid.
    pub fn load(path: &Path) -> Result<Self, StoreError> {
        let Some(text) = read_text(path)? else {
            return Ok(Self::default());
        };
        Self::parse(&text).map_err(|source| StoreError::Parameters {
            file: path.display().to_string(),
            source,
        })
    }

    /// Replaces a file atomically: written under another name, then renamed.
    ///
    /// # Errors
    /// [`StoreError`] if the file cannot be written; the old one is then unchanged.
    pub fn save(&self, path: &Path) -> Result<(), StoreError> {
        replace_file(path, &self.to_text())
    }

    /// The text of the file, which LinuxCNC reads too.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for (number, value) in &self.values {
            // Writing to a string cannot fail; all digits, so that a value is reproduced bit for bit.
            let _ = writeln!(text, "{number}\t{value:?}");
        }
        text
    }

    /// A parameter; `None` if it is not persistent.
    #[must_use]
    pub fn get(&self, number: u32) -> Option<f64> {
        self.values.get(&number).copied()
    }

    /// Makes a parameter persistent. Returns false, without effect, if the parameter does not exist or the
    /// value is not finite or beyond 1e9.
    pub fn set(&mut self, number: u32, value: f64) -> bool {
        let is_valid =
            (1..NUMBERED as u32).contains(&number) && value.is_finite() && value.abs() <= MAX_VALUE;
        if is_valid {
            self.values.insert(number, value);
        }
        is_valid
    }

    /// All of them, by number.
    pub fn iter(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.values.iter().map(|(number, value)| (*number, *value))
    }

    /// The active work offset, 0 for G54.
    #[must_use]
    pub fn active_offset(&self) -> usize {
        let number = self.value(WORK_OFFSET);
        if (1.0..=WORK_OFFSETS as f64).contains(&number) {
            number as usize - 1
        } else {
            0
        }
    }

    /// Work zero of an offset (0 for G54 to 8 for G59.3), machine coordinates in mm and degrees; zero for
    /// other indices.
    #[must_use]
    pub fn work_offset(&self, index: usize) -> Axes {
        if index >= WORK_OFFSETS {
            return Axes::zeros();
        }
        self.axes(WORK_OFFSET_1 + 20 * index)
    }

    /// Rotation of XY of a work offset, degrees.
    #[must_use]
    pub fn rotation_deg(&self, index: usize) -> f64 {
        if index >= WORK_OFFSETS {
            return 0.0;
        }
        self.value(WORK_OFFSET_1 + 20 * index + AXES)
    }

    /// The work offset with which `tip` (mm and degrees, machine coordinates less the tool offset) reads
    /// `values` in `axes`, as G10 L20 sets it. In a rotated system both X and Y of the zero change, so that
    /// an axis outside of `axes` keeps its reading.
    #[must_use]
    pub fn touch_off(&self, index: usize, axes: AxisMask, values: &Axes, tip: &Axes, g92: &Axes) -> Axes {
        let zero = self.work_offset(index);
        let rotation = rotation_of(self.rotation_deg(index));
        if rotation[0] == 0.0 {
            return Axes::from_fn(|i, _| {
                if axes.contains(i) {
                    tip[i] - g92[i] - values[i]
                } else {
                    zero[i]
                }
            });
        }
        let position = rotate_back(rotation, tip - zero) - g92;
        let change = Axes::from_fn(|i, _| {
            if axes.contains(i) {
                position[i] - values[i]
            } else {
                0.0
            }
        });
        zero + rotate(rotation, change)
    }

    /// Writes a work offset. Returns false, without effect, for an index above 8 or invalid values.
    pub fn set_work_offset(&mut self, index: usize, offset: &Axes) -> bool {
        let is_valid = index < WORK_OFFSETS
            && offset
                .iter()
                .all(|value| value.is_finite() && value.abs() <= MAX_VALUE);
        if is_valid {
            for (axis, value) in offset.iter().enumerate() {
                self.values
                    .insert((WORK_OFFSET_1 + 20 * index + axis) as u32, *value);
            }
        }
        is_valid
    }

    /// Supplies the values to a program: offsets, rotation, the positions of G28 and G30, and all others.
    pub fn apply(&self, settings: &mut Settings) {
        settings.parameters = self.iter().collect();
        for (index, offset) in settings.offsets.work.iter_mut().enumerate() {
            *offset = self.work_offset(index);
        }
        settings.offsets.active = self.active_offset();
        settings.offsets.g92 = if self.value(G92_ACTIVE) == 0.0 {
            Axes::zeros()
        } else {
            self.axes(G92)
        };
    }

    /// Takes over what a program has written to the persistent parameters, up to the line read last.
    pub fn update<R: BufRead>(&mut self, interpreter: &Interpreter<R>) {
        for (number, value) in &mut self.values {
            let now = interpreter.parameter(*number);
            if now.is_finite() && now.abs() <= MAX_VALUE {
                *value = now;
            }
        }
    }

    fn value(&self, number: usize) -> f64 {
        self.get(number as u32).unwrap_or(0.0)
    }

    fn axes(&self, first: usize) -> Axes {
        Axes::from_fn(|axis, _| self.value(first + axis))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Action;

    /// Result of G10 L20 in a system, and of touching off there: X and Y of the zero.
    fn touched(set_up: &str, system: usize, words: &str, values: [f64; 2], axes: AxisMask) -> [[f64; 2]; 2] {
        let mut before = PersistentParameters::default();
        run(set_up, &mut before);
        let mut after = PersistentParameters::default();
        run(&format!("{set_up}G10 L20 P{} {words}\n", system + 1), &mut after);
        let mut interpreter = Interpreter::new(set_up.as_bytes(), Settings::default());
        interpreter.start_at(set_up.lines().count() as u32).unwrap();
        // The machine is at (31, 17): each set-up ends there.
        let axes_of = |pair: [f64; 2]| Axes::from_fn(|axis, _| pair.get(axis).copied().unwrap_or(0.0));
        let g92 = Axes::from_fn(|axis, _| before.value(G92 + axis));
        let found = before.touch_off(system, axes, &axes_of(values), &axes_of([31.0, 17.0]), &g92);
        let expected = after.work_offset(system);
        [[expected[0], expected[1]], [found[0], found[1]]]
    }

    #[test]
    fn touching_off_in_a_rotated_system_is_g10_l20() {
        let [x, y] = [0, 1].map(|axis| AxisMask::from_bits(1 << axis));
        let both = AxisMask::from_bits(3);
        for (set_up, system) in [
            ("G10 L2 P1 X5 Y6 R30\nG53 G0 X31 Y17\n", 0),
            ("G10 L2 P2 X5 Y6 R-75\nG53 G0 X31 Y17\n", 1),
            ("G10 L2 P1 X5 Y6 R30\nG92 X3 Y-2\nG53 G0 X31 Y17\n", 0),
            ("G10 L2 P1 X5 Y6\nG92 X3 Y-2\nG53 G0 X31 Y17\n", 0),
        ] {
            for (words, values, axes) in [
                ("X1", [1.0, 0.0], x),
                ("Y-4", [0.0, -4.0], y),
                ("X1 Y-4", [1.0, -4.0], both),
            ] {
                let [expected, found] = touched(set_up, system, words, values, axes);
                assert!(
                    (expected[0] - found[0]).abs() < 1e-9 && (expected[1] - found[1]).abs() < 1e-9,
                    "{set_up}{words}: {expected:?}, {found:?}"
                );
            }
        }
    }

    fn run(program: &str, persistent: &mut PersistentParameters) -> Vec<Action> {
        let mut settings = Settings::default();
        persistent.apply(&mut settings);
        let mut interpreter = Interpreter::new(program.as_bytes(), settings);
        let mut actions = Vec::new();
        for item in &mut interpreter {
            actions.push(item.unwrap().action);
        }
        persistent.update(&interpreter);
        actions
    }

    fn end_of(actions: &[Action]) -> Axes {
        let mut moves = actions.iter().filter_map(|action| match action {
            Action::Move(step) => Some(step.curve.end()),
            _ => None,
        });
        moves.next_back().unwrap()
    }

    #[test]
    fn a_linuxcnc_file_round_trips() {
        let persistent =
            PersistentParameters::parse("5161\t1.5\n5220 2.000000\n5241 -10\n5250 90\n100 7 ; mine\n\n")
                .unwrap();
        assert_eq!(
            (persistent.get(5161), persistent.get(100), persistent.get(101)),
            (Some(1.5), Some(7.0), None)
        );
        assert_eq!(
            (
                persistent.active_offset(),
                persistent.work_offset(1)[0],
                persistent.rotation_deg(1)
            ),
            (1, -10.0, 90.0)
        );
        assert_eq!(PersistentParameters::parse(&persistent.to_text()), Ok(persistent));
    }

    #[test]
    fn stored_values_round_trip_bit_for_bit() {
        let mut persistent = PersistentParameters::default();
        for (number, value) in [(31, 0.1 + 0.2), (32, -1e-300), (33, 1e9), (34, 1.0 / 3.0)] {
            assert!(persistent.set(number, value));
        }
        assert_eq!(PersistentParameters::parse(&persistent.to_text()), Ok(persistent));
    }

    #[test]
    fn invalid_parameter_files_report_the_line() {
        for (text, line) in [
            ("5161", 1),
            ("5161 1\nx 1", 2),
            ("1 nan", 1),
            ("1 1e10", 1),
            ("-1 0", 1),
            ("1 2 3", 1),
        ] {
            match PersistentParameters::parse(text) {
                Err(ParameterFileError::Line { line: found, .. }) => assert_eq!(found, line, "{text}"),
                other => panic!("{text}: {other:?}"),
            }
        }
        assert_eq!(
            PersistentParameters::parse("0 1"),
            Err(ParameterFileError::Number { line: 1, number: 0 })
        );
        assert_eq!(
            PersistentParameters::parse("5602 1"),
            Err(ParameterFileError::Number {
                line: 1,
                number: 5602
            })
        );
        assert_eq!(
            PersistentParameters::parse("31 1\n31 1"),
            Err(ParameterFileError::Twice { line: 2, number: 31 })
        );
        let mut persistent = PersistentParameters::default();
        assert!(!persistent.set(0, 1.0) && !persistent.set(5602, 1.0) && !persistent.set(31, f64::NAN));
        assert!(!persistent.set_work_offset(9, &Axes::zeros()));
        assert!(!persistent.set_work_offset(0, &Axes::repeat(f64::INFINITY)));
    }

    #[test]
    fn parameters_persist_to_the_next_program() {
        let mut persistent = PersistentParameters::parse("100 0").unwrap();
        run(
            "#100=42 #101=43\nG10 L2 P2 X10 Y20 R90\nG55\nG92 Z5\nG0 X1\nG28.1\nM2\n",
            &mut persistent,
        );
        assert_eq!((persistent.get(100), persistent.get(101)), (Some(42.0), None));
        let text = persistent.to_text();
        let mut persistent = PersistentParameters::parse(&text).unwrap();
        // G55 rotated by 90 degrees: X1 of the work is one beyond Y20 of the machine.
        let end = end_of(&run("G55 G0 X1 Y0 Z0\nM2\n", &mut persistent));
        assert!(
            (end[0] - 10.0).abs() < 1e-12 && (end[1] - 21.0).abs() < 1e-12,
            "{end}"
        );
        assert_eq!(end[2], -5.0);
        assert_eq!(
            persistent.to_text(),
            text,
            "a run that writes nothing keeps everything"
        );
    }

    #[test]
    fn the_next_program_begins_in_g54() {
        for end in ["M2\n", "M30\n", ""] {
            let mut persistent = PersistentParameters::default();
            run(&format!("G10 L2 P2 X50\nG55 G0 X1\n{end}"), &mut persistent);
            assert_eq!(
                (persistent.active_offset(), persistent.work_offset(1)[0]),
                (0, 50.0)
            );
            assert_eq!(end_of(&run("G0 X1\nM2\n", &mut persistent))[0], 1.0);
        }
        // Without an end, as after an MDI block, it is kept.
        let mut persistent = PersistentParameters::default();
        let settings = Settings {
            is_mdi: true,
            ..Settings::default()
        };
        let mut block = Interpreter::new("G55\n".as_bytes(), settings);
        while block.next().is_some() {}
        persistent.update(&block);
        assert_eq!(persistent.active_offset(), 1);
    }

    #[test]
    fn the_next_program_can_restore_a_suspended_g92() {
        let mut persistent = PersistentParameters::default();
        run("G92 X7\nG92.2\nM2\n", &mut persistent);
        assert_eq!(
            (persistent.get(5210), persistent.get(5211)),
            (Some(0.0), Some(-7.0))
        );
        assert_eq!(
            end_of(&run("G0 X1\nG92.3\nG0 X1\nM2\n", &mut persistent))[0],
            -6.0
        );
    }

    #[test]
    fn files_are_replaced_atomically() {
        let folder = std::env::temp_dir().join(format!("evolvent-kept-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("mill.var");
        assert_eq!(
            PersistentParameters::load(&file).unwrap(),
            PersistentParameters::default()
        );
        let mut persistent = PersistentParameters::default();
        persistent.set(31, 1.0);
        persistent.save(&file).unwrap();
        let link = folder.join("link.var");
        std::os::unix::fs::symlink(&file, &link).unwrap();
        persistent.set(31, 2.0);
        persistent.save(&link).unwrap();
        assert_eq!(PersistentParameters::load(&file).unwrap().get(31), Some(2.0));
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(
            std::fs::read_dir(&folder).unwrap().count(),
            2,
            "nothing is left beside"
        );
        std::fs::write(&file, "nonsense").unwrap();
        let error = PersistentParameters::load(&file).unwrap_err().to_string();
        assert!(error.contains("mill.var") && error.contains("line 1"), "{error}");
        assert!(matches!(
            persistent.save(&folder.join("no/such")),
            Err(StoreError::Write { .. })
        ));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
