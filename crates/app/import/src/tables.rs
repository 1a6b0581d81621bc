//! Tool tables and parameter files, in mm.

use std::collections::BTreeSet;

use evolvent_gcode::{ToolTable, ToolTableError};
use evolvent_path::AxisLetter;

/// A tool table of LinuxCNC with lengths in mm, and its invalid lines.
pub(crate) fn tool_table(text: &str, mm_per_unit: f64) -> (ToolTable, Vec<ToolTableError>) {
    let (mut table, odd) = ToolTable::parse_lines(text);
    for mut tool in table.tools().to_vec() {
        for letter in AxisLetter::ALL.into_iter().filter(|letter| !letter.is_rotary()) {
            tool.offset[letter.index()] *= mm_per_unit;
        }
        tool.diameter_mm *= mm_per_unit;
        table.set(tool);
    }
    (table, odd)
}

/// Numbers of parameters that are lengths: X Y Z U V W of the home positions, of G92, of the probe and of the
/// nine work offsets.
fn lengths() -> BTreeSet<u32> {
    let mut first = vec![5061, 5161, 5181, 5211];
    first.extend((0..9).map(|system| 5221 + 20 * system));
    let linear = [0, 1, 2, 6, 7, 8];
    first
        .iter()
        .flat_map(|first| linear.map(|axis| first + axis))
        .collect()
}

/// A parameter file of LinuxCNC with lengths in mm, or the first invalid line.
pub(crate) fn parameters(text: &str, mm_per_unit: f64) -> Result<String, usize> {
    let lengths = lengths();
    let mut out = String::new();
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let (Some(number), value) = (words.next(), words.next()) else {
            continue;
        };
        let number: u32 = number.parse().map_err(|_| index + 1)?;
        let value: f64 = value.and_then(|value| value.parse().ok()).ok_or(index + 1)?;
        if !value.is_finite() {
            return Err(index + 1);
        }
        let factor = if lengths.contains(&number) {
            mm_per_unit
        } else {
            1.0
        };
        out.push_str(&format!("{number}\t{:.6}\n", value * factor));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_become_mm_and_angles_stay() {
        let (table, odd) = tool_table("T1 P1 D0.5 Z1 A30 ; drill\n", 25.4);
        assert_eq!(odd, []);
        let text = table.to_text();
        let table = ToolTable::parse(&text).unwrap();
        let tool = table.get(1).unwrap();
        assert_eq!(
            (
                table.tools().len(),
                tool.diameter_mm,
                tool.offset[2],
                tool.offset[3]
            ),
            (1, 12.7, 25.4, 30.0)
        );
        assert!(text.contains("drill"));
        let text = parameters("5221 1.0\n5224 30\n5210 1\n100 2.0\n5381 2\n", 25.4).unwrap();
        assert_eq!(
            text,
            "5221\t25.400000\n5224\t30.000000\n5210\t1.000000\n100\t2.000000\n5381\t50.800000\n"
        );
        assert_eq!(parameters("5221 1\nx y\n", 1.0), Err(2));
    }
}
