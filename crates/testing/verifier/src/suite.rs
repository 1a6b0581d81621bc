//! Programs for comparing planners, written for this project.
//!
//! Every program belongs to a class in which planners differ: dense chains of chords, folds, noise, reliefs,
//! arcs in chains, corners, moves smaller than the tolerance, tangent joints, helices, involutes. Path mode
//! is `G64 P0.02 Q0` throughout. If the direction matters, there are copies rotated by 30 and 45 degrees,
//! because the limits of the axes do not rotate. Random values have fixed seeds, so that the programs are the
//! same everywhere.

mod butterfly;
mod chains;
mod corners;
mod curves;
mod pen;

pub use butterfly::butterfly_point;
use pen::Pen;

/// A part program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// Name, without ending.
    pub name: String,
    /// RS274/NGC.
    pub text: String,
}

/// Rotations about Z, degrees.
const ROTATIONS: [u32; 3] = [0, 30, 45];

/// Draws a program with a pen.
type Draw = fn(&mut Pen);

/// The programs of the standing benchmark, in the order of its tables. About 100 000 blocks in total; not for
/// the cycle.
#[must_use]
pub fn suite() -> Vec<Program> {
    let turned: [(&str, Draw); 9] = [
        ("folded-25um", chains::folded),
        ("corners", corners::corners),
        ("squares", corners::squares),
        ("letters", corners::letters),
        ("pocket", curves::pocket),
        ("slots", curves::slots),
        ("butterfly-200", |pen| butterfly::butterfly(pen, 200)),
        ("butterfly-2000", |pen| butterfly::butterfly(pen, 2000)),
        ("butterfly-20000", |pen| butterfly::butterfly(pen, 20_000)),
    ];
    let once: [(&str, Draw); 9] = [
        ("circle-10000", |pen| chains::circle(pen, 10_000)),
        ("noise-1um", chains::noise),
        ("relief-hills", chains::relief),
        ("spiral-999-arcs", curves::spiral),
        ("tiny-moves", corners::tiny),
        ("rapids", corners::rapids),
        ("circles", curves::circles),
        ("helices", curves::helices),
        ("bore-involutes", curves::bore),
    ];
    let mut programs = Vec::new();
    for (name, draw) in once {
        programs.push(Program {
            name: name.to_owned(),
            text: Pen::draw(0.0, draw),
        });
    }
    for (name, draw) in turned {
        for degrees in ROTATIONS {
            programs.push(Program {
                name: format!("{name}-r{degrees}"),
                text: Pen::draw(f64::from(degrees), draw),
            });
        }
    }
    programs
}

/// The butterfly in a number of chords, for tables of the growth of cost.
#[must_use]
pub fn butterfly_program(chords: usize) -> Program {
    Program {
        name: format!("butterfly-{chords}"),
        text: Pen::draw(0.0, |pen| butterfly::butterfly(pen, chords)),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use evolvent_gcode::Settings;
    use evolvent_machine::Machine;

    use super::*;
    use crate::Route;

    #[test]
    fn every_program_is_readable_and_named_uniquely() {
        let machine = include_str!("../../../../config/machines/bench-3axis.toml");
        let machine = Machine::parse(machine, "bench-3axis.toml").expect("machine");
        let settings = Settings {
            axes: machine.limits().present,
            ..Settings::default()
        };
        let programs = suite();
        let names: BTreeSet<&str> = programs.iter().map(|program| program.name.as_str()).collect();
        assert_eq!(names.len(), programs.len());
        for program in &programs {
            let route = Route::read(program.text.as_bytes(), settings.clone(), &machine);
            let route = route.unwrap_or_else(|error| panic!("{}: {error}", program.name));
            assert!(route.length_mm() > 1.0, "{}", program.name);
        }
    }

    #[test]
    fn a_turned_program_is_as_long_as_the_original() {
        let machine = include_str!("../../../../config/machines/bench-3axis.toml");
        let machine = Machine::parse(machine, "bench-3axis.toml").expect("machine");
        let length = |name: &str| {
            let program = suite().into_iter().find(|program| program.name == name);
            let program = program.expect("program");
            let route = Route::read(program.text.as_bytes(), Settings::default(), &machine);
            route.expect("route").length_mm()
        };
        for name in ["slots", "letters", "folded-25um"] {
            let original = length(&format!("{name}-r0"));
            let turned = length(&format!("{name}-r30"));
            // Five decimals.
            assert!(
                (turned / original - 1.0).abs() < 2e-4,
                "{name}: {turned} {original}"
            );
        }
    }
}
