//! The run of one program.

use std::cell::{Cell, RefCell};
use std::io::BufReader;

use evolvent_motion::{Inputs, PlannerLag};
use evolvent_runtime::{RecordedInputs, SignalChange, SignalName, recompute};
use evolvent_trace::{CycleRecord, inputs as bits};
use evolvent_turning::LoadSample;
use evolvent_verifier::{Judge, Route};

use super::comparing::Comparing;
use super::lots::{Records, read};
use super::signals::{RecordedSignals, tell_difference};
use super::watch::Watch;
use super::*;

/// Inputs of the recomputation besides the trace.
struct Again<'a> {
    program: &'a Path,
    setup: &'a evolvent_runtime::Setup,
    feed_override: f64,
    optional_stop: bool,
    lines: &'a [String],
    comparing: Comparing,
    signals: RecordedSignals,
}

pub(super) fn verify(mut opened: Opened, mut verified: Verified) -> Result<Verified, InspectError> {
    let setup = opened.setup()?;
    let lines = opened.program_lines();
    let folder = folder()?;
    let program = folder.path().join(file_name(&opened.run.program_name));
    let has_program = match &opened.program {
        Some(text) => {
            write(&program, text)?;
            write_subroutines(&mut opened.trace, "subroutines/", folder.path())?;
            true
        }
        None => {
            verified
                .notes
                .push("no program is attached: only limits were checked".to_owned());
            false
        }
    };
    let route = if has_program && setup.start_line.is_none() {
        let text = opened.program.as_deref().unwrap_or_default();
        let settings = setup.interpreter_settings_for(&program);
        match Route::read(BufReader::new(text), settings, &opened.machine) {
            Ok(route) => Some(route),
            Err(error) => {
                verified.notes.push(format!("the path was not checked: {error}"));
                None
            }
        }
    } else {
        None
    };
    let extra = |key: &str| opened.run.extra.get(key).map(String::as_str);
    let feed_override = extra("feed_override").and_then(|text| text.parse().ok());
    let optional_stop = extra("optional_stop") == Some("true");
    let home = setup.machine.limits().home;
    let period_ns = opened.run.period_ns;
    let watch = Watch::new(
        LimitCheck::new(&opened.machine, period_ns, &home.into()),
        route
            .as_ref()
            .map(|route| Judge::new(&opened.machine, period_ns, route)),
        VecDeque::new(),
    );
    let signals = RecordedSignals::read(&mut opened.trace)?;
    let again = Again {
        signals,
        program: &program,
        setup: &setup,
        feed_override: feed_override.unwrap_or(1.0),
        optional_stop,
        lines: &lines,
        comparing: Comparing {
            axes: opened.run.axes.clone(),
            period_s: opened.period_s(),
            columns: opened.run.columns,
        },
    };
    let trace = &mut opened.trace;
    let watch = thread::scope(|scope| -> Result<Watch<'_>, InspectError> {
        let (mut records, lots) = read(scope, trace);
        let checker = scope.spawn(move || watch.run(&lots));
        if has_program {
            compute(&again, &mut records, &mut verified)?;
        }
        beyond(&again, &mut records, &mut verified);
        // A panic of a thread is a bug; it is passed on.
        let watch = checker
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match records.failure() {
            Some(error) => Err(error.into()),
            None => Ok(watch),
        }
    })?;
    watch.conclude(&mut verified);
    Ok(verified)
}

fn compute(again: &Again<'_>, records: &mut Records, verified: &mut Verified) -> Result<(), InspectError> {
    let last = Cell::new(Inputs {
        feed_override: again.feed_override,
        ..Inputs::default()
    });
    let present = Cell::new(None);
    let runs_on = Cell::new(false);
    let records = RefCell::new(records);
    let recomputed = recompute(
        again.program,
        again.setup,
        again.feed_override,
        again.optional_stop,
        &again.signals.inputs,
        |sequence| {
            let record = records.borrow_mut().advance(sequence)?;
            present.set(record);
            Some(match record {
                Some(record) => {
                    let recorded = recorded_inputs(&record, last.get().load);
                    last.set(recorded.inputs);
                    runs_on.set(recorded.runs_on);
                    recorded
                }
                // For a lost cycle, nothing is known to have changed.
                None => RecordedInputs {
                    inputs: last.get(),
                    lag: PlannerLag::default(),
                    runs_on: runs_on.get(),
                    outputs_safe: false,
                },
            })
        },
        |setpoint, corrected| {
            if let Some(record) = present.get() {
                again
                    .comparing
                    .compare(&record, setpoint, corrected, verified, again.lines);
            }
            true
        },
    )
    .map_err(|source| InspectError::Io {
        what: "a thread for the planner".to_owned(),
        source,
    })?;
    verified.recomputed = true;
    compare_outputs(again, &recomputed.outputs, verified);
    if let Err(error) = recomputed.program {
        verified.notes.push(format!("the program has an error: {error}"));
    }
    Ok(())
}

/// Checks that every output changes with the same setpoint to the same value.
fn compare_outputs(again: &Again<'_>, recomputed: &[SignalChange], verified: &mut Verified) {
    let recorded = &again.signals.outputs;
    let same = recorded
        .iter()
        .zip(recomputed)
        .take_while(|(a, b)| a == b)
        .count();
    let (left, right) = (recorded.get(same), recomputed.get(same));
    let Some(first) = [left, right]
        .into_iter()
        .flatten()
        .min_by_key(|change| change.sequence)
    else {
        return;
    };
    verified.differing += 1;
    let settings = &again.setup.machine.signals;
    let name = match first.name {
        SignalName::Signal(kind, number) => settings
            .output(kind, number)
            .map_or_else(|| number.to_string(), |output| output.name.clone()),
        SignalName::Spindle(number) => format!("of spindle {number}"),
        SignalName::Probe(number) => format!("of probe {number}"),
        SignalName::Angle(_) | SignalName::AngleSpindle => "of the angle of a spindle".to_owned(),
        SignalName::Speed(_) => "of the speed of a spindle".to_owned(),
    };
    let difference = Difference {
        sequence: first.sequence,
        time_s: first.sequence as f64 * again.comparing.period_s,
        line: 0,
        text: String::new(),
        quantity: format!("output {name}"),
        recorded: left.and_then(|change| change.value).unwrap_or(f64::NAN),
        recomputed: right.and_then(|change| change.value).unwrap_or(f64::NAN),
    };
    tell_difference(difference, verified);
}

/// Reports the part of the trace that the recomputed run did not reach.
fn beyond(again: &Again<'_>, records: &mut Records, verified: &mut Verified) {
    while let Some(record) = records.next() {
        if !verified.recomputed {
            continue;
        }
        verified.differing += 1;
        verified.first_difference.get_or_insert_with(|| Difference {
            sequence: record.sequence,
            time_s: record.sequence as f64 * again.comparing.period_s,
            line: record.line,
            text: text_of(again.lines, record.line),
            quantity: "end of the run: it ends when recomputed".to_owned(),
            recorded: record.path_mm,
            recomputed: f64::NAN,
        });
    }
}

/// The recorded inputs of a cycle; `load` is the reading of the previous cycle.
pub(super) fn recorded_inputs(record: &CycleRecord, load: Option<LoadSample>) -> RecordedInputs {
    RecordedInputs {
        inputs: Inputs {
            feed_override: record.override_,
            hold: record.inputs & bits::HOLD != 0,
            stop: record.inputs & bits::STOP != 0,
            resume: record.inputs & bits::RESUME != 0,
            load: (!record.load.is_nan()).then(|| LoadSample {
                // Only a change of the number matters, not the number itself.
                sequence: load.map_or(0, |load| load.sequence) + u64::from(record.inputs & bits::LOAD != 0),
                value: record.load,
                range_max: if record.inputs & bits::LOAD_AT_END != 0 {
                    record.load
                } else {
                    f64::INFINITY
                },
            }),
            ..Inputs::default()
        },
        lag: PlannerLag {
            failed_lookup: (record.inputs & bits::WAITED != 0)
                .then_some((record.inputs >> bits::FAILED_LOOKUP_SHIFT) as u8),
            refused: record.inputs & bits::REFUSED != 0,
        },
        runs_on: record.inputs & bits::RUNS_ON != 0,
        outputs_safe: record.inputs & bits::OUTPUTS_SAFE != 0,
    }
}
