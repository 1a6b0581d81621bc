//! Modes between jobs: those in force when a block of MDI starts, and those that it leaves.

use evolvent_gcode::{
    Diagnostic, Interpreter, MdiPreamble, Modal, Outputs, PersistentParameters, Settings, StartOffsets,
    ToolTable,
};
use evolvent_path::{Axes, AxisLetter};

/// The state after a program text.
#[derive(Clone, Debug)]
pub(crate) struct After {
    pub modes: Modes,
    pub kept: PersistentParameters,
    pub tools: Option<ToolTable>,
}

/// Modes in force.
#[derive(Clone, Debug)]
pub(crate) struct Modes {
    pub modal: Modal,
    /// The modes as one line of codes.
    text: String,
    /// The F word as written, and whether it is in inches.
    feed: Option<(f64, bool)>,
    /// The spindle of threads and cycles without `$`.
    active_spindle: u32,
}

impl Modes {
    /// The modes at the start of a program.
    pub(crate) fn at_start(settings: &Settings) -> Result<Self, Box<Diagnostic>> {
        simulate_modes("", settings, &PersistentParameters::default()).map(|after| after.modes)
    }

    /// What an interpreter must know of the preamble and the previous modes before it reads the text.
    pub(crate) fn restored(&self, preamble: &str) -> MdiPreamble {
        MdiPreamble {
            lines: preamble.lines().count() as u32,
            active_spindle: self.active_spindle,
        }
    }

    /// Lines that bring an interpreter into these modes. Excluded are spindle, coolant, the selected tool,
    /// and motion modes other than G0 and G1, since arcs and cycles cannot be alone on a line. Work offsets
    /// and G92 are kept in parameters.
    pub(crate) fn preamble(&self) -> String {
        let mut text = String::new();
        let offset = &self.modal.tool_offset;
        if *offset == Axes::zeros() {
            text.push_str("G49");
        } else {
            // In G7 X would be a diameter.
            text.push_str("G21 G8 G43.1");
            for axis in AxisLetter::ALL
                .into_iter()
                .filter(|axis| offset[axis.index()] != 0.0)
            {
                text.push(' ');
                text.push(axis.letter());
                text.push_str(&offset[axis.index()].to_string());
            }
        }
        text.push('\n');
        if let Some((word, inches)) = self.feed {
            let unit = if inches { "G20" } else { "G21" };
            let modes = [930, 940, 950];
            let mode = self.modal.codes.iter().find(|code| modes.contains(code));
            // Feed per revolution refers to one spindle; with another one the feed would be lost.
            let spindle = self.text.split(' ').find(|word| word.starts_with('$'));
            let spindle = spindle.filter(|_| mode == Some(&950)).unwrap_or_default();
            text.push_str(&format!(
                "{unit}\nG{} F{word} {spindle}\n",
                mode.unwrap_or(&940) / 10
            ));
        }
        // The first word is the motion; the words from S on belong to the periphery.
        let mut words = self.text.split(' ');
        let motion = words.next().filter(|word| ["G0", "G1"].contains(word));
        let words: Vec<&str> = words
            .take_while(|word| !word.starts_with('S'))
            // Tool offsets are given by their values above, and the active work offset by the kept
            // parameters. A G49 of an MDI block before a program would cancel the tool length at the end of
            // that program.
            .filter(|word| {
                !["G41", "G43", "G49"].contains(word) && !word.starts_with('F') && !selects_work(word)
            })
            .collect();
        text.push_str(&words.join(" "));
        text.push('\n');
        text.push_str(motion.unwrap_or_default());
        text.push('\n');
        text
    }
}

/// Whether a word is one of G54 to G59.3.
fn selects_work(word: &str) -> bool {
    (54..=59).any(|number| word.starts_with(&format!("G{number}")))
}

/// Interprets a text without motion and returns the state after it, or its first error. `kept` lists the
/// parameters that are kept.
pub(crate) fn simulate_modes(
    text: &str,
    settings: &Settings,
    kept: &PersistentParameters,
) -> Result<After, Box<Diagnostic>> {
    let lines = text.lines().count() as u32;
    let padded = format!("{text}\n\n");
    // Modes persist from block to block, including the mode of the spindle (G96).
    let settings = Settings {
        is_mdi: true,
        ..settings.clone()
    };
    let mut interpreter = Interpreter::new(padded.as_bytes(), settings.clone());
    let restart = interpreter.start_at(lines + 1);
    let mut kept = kept.clone();
    kept.update(&interpreter);
    if interpreter.has_ended() {
        // After M2 or M30 the next text starts like a program. G20 and G21 persist, as in LinuxCNC.
        let tools = interpreter.tools().cloned();
        let fresh = Settings {
            outputs: Outputs::default(),
            preamble: MdiPreamble::default(),
            inches: interpreter.modal().codes.contains(&200),
            offsets: StartOffsets {
                work: std::array::from_fn(|index| kept.work_offset(index)),
                active: kept.active_offset(),
                ..settings.offsets
            },
            ..settings
        };
        let modes = Modes::at_start(&fresh)?;
        return Ok(After { modes, kept, tools });
    }
    let restart = restart?;
    Ok(After {
        modes: Modes {
            active_spindle: interpreter.modal().active_spindle,
            modal: interpreter.modal(),
            text: restart.modes,
            feed: restart.feed_word,
        },
        kept,
        tools: interpreter.tools().cloned(),
    })
}

#[cfg(test)]
mod tests {
    use evolvent_path::Plane;

    use super::*;

    /// Starts with the given active work offset.
    fn after(text: &str, active: usize) -> After {
        let mut settings = Settings::default();
        settings.offsets.active = active;
        simulate_modes(text, &settings, &PersistentParameters::default()).unwrap()
    }

    #[test]
    fn an_interpreter_after_the_preamble_has_equal_modes() {
        for text in [
            "",
            "G91 G20 G18 F12\n",
            "G55 G61 G93\n",
            "G64 P0.02 G90.1 G99\n",
            "G43.1 Z12.5 X-1\nG91 G59.3\n",
            "M3 S500 F100 G1 X1\n",
            "G1 F100\nG0 X1\n",
            "G1 F100\nG20\n",
            "G20 F4\nG21\n",
            "G20 G95 F0.1\nG21 G64 P0.02 Q0.005\n",
            "G64 P0.02 Q0.005\nG20\nT7\n",
        ] {
            let first = after(text, 0);
            let modes = first.modes;
            let again = after(&modes.preamble(), first.kept.active_offset()).modes;
            let inches = Settings {
                inches: true,
                plane: Plane::Zx,
                diameter: true,
                offsets: StartOffsets {
                    active: first.kept.active_offset(),
                    ..StartOffsets::default()
                },
                ..Settings::default()
            };
            let in_inches = simulate_modes(&modes.preamble(), &inches, &first.kept).unwrap();
            assert_eq!(
                in_inches.modes.modal, again.modal,
                "{text:?} on a lathe in inches, X in diameters"
            );
            assert_eq!(
                in_inches.modes.text, again.text,
                "{text:?} on a lathe in inches, X in diameters"
            );
            let mut expected = modes.modal;
            expected.spindle_rpm = 0.0;
            // The selected tool comes from the setup.
            expected.selected_tool = None;
            assert_eq!(again.modal, expected, "{text:?} by {:?}", modes.preamble());
            assert_eq!(
                again.text.split(' ').next(),
                modes.text.split(' ').next(),
                "{text:?}"
            );
            assert_eq!(again.feed, modes.feed, "{text:?}");
            let path = |modes: &Modes| {
                let from = modes.text.find("G6").unwrap();
                modes.text[from..from + modes.text[from..].find(" G9").unwrap()].to_owned()
            };
            assert_eq!(path(&again), path(&modes), "{text:?}");
        }
    }

    /// The contact of an earlier block does not count as contact of this one.
    #[test]
    fn an_abort_after_a_probing_move_is_left_to_the_check() {
        let abort = "o1 if [#5070 NE 0]\n(ABORT,contact)\no1 endif\nG91\n";
        let modes = after(&format!("#5070=1\nG38.3 X10 F100\n{abort}"), 0).modes;
        assert!(modes.text.contains("G91"), "{}", modes.text);
        let before = simulate_modes(
            &format!("#5070=1\n{abort}"),
            &Settings::default(),
            &PersistentParameters::default(),
        );
        assert!(before.is_err());
    }

    /// A program has ended in between. Its final modes are known, but not its words.
    #[test]
    fn tool_length_at_program_end_stays_in_force() {
        for (text, length) in [
            ("G49\n", 45.2),
            ("", 45.2),
            ("G43.1 Z7\n", 45.2),
            ("G43.1 Z7\n", 0.0),
        ] {
            let mut modes = after(text, 0).modes;
            modes.modal.tool_offset[2] = length;
            let next = after(&(modes.preamble() + "G0 X1\n"), 0).modes;
            assert_eq!(
                next.modal.tool_offset[2],
                length,
                "{text:?} by {:?}",
                modes.preamble()
            );
        }
    }

    #[test]
    fn work_offset_at_program_end_stays_in_force() {
        let block = after("G55\n", 0);
        assert_eq!(block.kept.active_offset(), 1);
        // A program has ended with M2 in between, so the next block begins in G54.
        let next = after(&(block.modes.preamble() + "G0 X1\n"), 0);
        assert_eq!(next.modes.modal.work_system, 540, "{:?}", block.modes.preamble());
        let stays = after(&(block.modes.preamble() + "G0 X1\n"), 1);
        assert_eq!(stays.modes.modal.work_system, 550);
    }

    #[test]
    fn errors_and_offsets_are_known_before_motion() {
        let settings = Settings::default();
        let kept = PersistentParameters::default();
        assert!(simulate_modes("G1 X1\n", &settings, &kept).is_err(), "no feed");
        let after = simulate_modes("G10 L2 P2 X7\n", &settings, &kept).unwrap();
        assert_eq!(after.kept.work_offset(1)[0], 7.0);
    }

    #[test]
    fn the_feed_of_another_spindle_persists_across_blocks() {
        let mut settings = Settings::default();
        settings.features.spindles = [true; evolvent_gcode::SPINDLES];
        let kept = PersistentParameters::default();
        let mut text = "G95 F0.2 S300 $1\n".to_owned();
        for block in ["M3 $1\n", "G0 X1\n", "G20\n"] {
            let after = simulate_modes(&text, &settings, &kept).unwrap();
            assert_eq!(
                after.modes.feed.map(|(word, _)| word),
                Some(0.2),
                "before {block:?}"
            );
            assert!(after.modes.text.contains("$1"), "{:?}", after.modes.text);
            text = after.modes.preamble() + block;
        }
    }

    #[test]
    fn thread_and_feed_spindles_persist_across_blocks() {
        let mut settings = Settings::default();
        settings.features.spindles = [true; evolvent_gcode::SPINDLES];
        let kept = PersistentParameters::default();
        let mut text = "G95 F0.2 S300 $1\n".to_owned();
        for (block, active) in [
            ("G0 X1\n", 1),
            ("G97 S100 $2\n", 2),
            ("M3 S200 $3\n", 2),
            ("G20\n", 2),
            ("G94\n", 0),
            ("G97 $3\n", 3),
            ("M2\n", 0),
        ] {
            text.push_str(block);
            let after = simulate_modes(&text, &settings, &kept).unwrap().modes;
            assert_eq!(after.active_spindle, active, "after {block:?}");
            text = after.preamble();
            settings.preamble = after.restored(&text);
        }
    }

    #[test]
    fn the_spindle_mode_persists_across_blocks() {
        let mut settings = Settings::default();
        let kept = PersistentParameters::default();
        let after = simulate_modes("G96 D900 S180 M3\n", &settings, &kept).unwrap();
        assert!(after.modes.modal.codes.contains(&960));
        settings.outputs.spindles[0].surface = Some(evolvent_path::SurfaceSpeed {
            speed_m_min: 180.0,
            max_rpm: 900.0,
            centre_mm: 0.0,
        });
        let next = simulate_modes(&after.modes.preamble(), &settings, &kept).unwrap();
        assert!(next.modes.modal.codes.contains(&960), "{:?}", next.modes.text);
        assert_eq!(next.modes.text, after.modes.text.replace("M3", "M5"));
    }

    #[test]
    fn m2_resets_modes_and_keeps_parameters() {
        let settings = Settings::default();
        let kept = PersistentParameters::default();
        for end in ["M2", "M30"] {
            let first = simulate_modes(&format!("G10 L2 P1 X9 {end}\n"), &settings, &kept).unwrap();
            assert_eq!(first.modes.modal.work_offset[0], 9.0, "{end}");
            let text = format!("G91 G20 G55 G95 G96 S100 M3\nG10 L2 P2 X7 {end}\n");
            let after = simulate_modes(&text, &settings, &kept).unwrap();
            let inches = Settings {
                inches: true,
                ..settings.clone()
            };
            let start = Modes::at_start(&inches).unwrap();
            assert_eq!(after.modes.modal, start.modal, "{end}");
            let lathe = Settings {
                plane: Plane::Zx,
                diameter: true,
                ..settings.clone()
            };
            let after = simulate_modes(&format!("G17 G8 {end}\n"), &lathe, &kept).unwrap();
            for code in [180, 70] {
                assert!(after.modes.modal.codes.contains(&code), "{end} {code}");
            }
            let after = simulate_modes(&text, &settings, &kept).unwrap();
            assert!((after.kept.work_offset(1)[0] - 177.8).abs() < 1e-9, "{end}");
        }
        assert!(
            simulate_modes("G1 X1\nM2\n", &settings, &kept).is_err(),
            "an error before it counts"
        );
    }

    #[test]
    fn compensation_left_on_by_mdi_is_refused_with_advice() {
        let fault = |text: &str| {
            let kept = PersistentParameters::default();
            simulate_modes(text, &Settings::default(), &kept).err()
        };
        for text in [
            "G41.1 D4\n",
            "G42.1 D4\n",
            "F100 G41.1 D4 G1 X10\n",
            "G41.1 D4\nG1 F100 X10\n",
        ] {
            let error = fault(text).unwrap();
            let message = format!("{}; {}", error.message, error.help.as_deref().unwrap_or_default());
            assert!(
                message.starts_with("cutter compensation cannot be used in MDI"),
                "{message}"
            );
            assert!(
                message.contains("a subroutine that MDI calls") && !message.contains("line 3"),
                "{message}"
            );
        }
        // A block that calls a contour, and the contour ends its compensation, leaves none on.
        let contour = "o<cut> sub\nG41.1 D4\nG1 F100 X10\nX20\nG40 X30\no<cut> endsub\no<cut> call\n";
        assert!(fault(contour).is_none());
        let nurbs = fault("F100 G5.2 P1 L3 X0 Y1\n").unwrap();
        assert!(nurbs.message.contains("cannot be written in MDI"), "{nurbs:?}");
    }
}
