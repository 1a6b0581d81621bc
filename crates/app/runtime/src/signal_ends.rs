//! The queues of a machine's outputs and inputs: one end for each thread.

use evolvent_machine::SignalSettings;
use evolvent_signals::{Scheduler, Signals, schedule};

use crate::input_script::InputScript;
use crate::job::{Job, Setup};
use crate::queues::optional_ring;
use crate::signal_loop::{InputSource, SignalLoop};
use crate::signal_port::{CHANGES, SAMPLES, SignalPort};
use crate::signal_recorder::SignalRecorder;

/// The ends. A machine without signals has only those of cycle and planner, for the overrides that a program
/// switches.
#[derive(Default)]
pub(crate) struct SignalEnds {
    /// The publisher's, if there is one.
    pub port: Option<SignalPort>,
    /// The recorder's, if there is one.
    pub recorder: Option<SignalRecorder>,
    /// The cycle's.
    pub cycle: Option<SignalLoop>,
    /// The planner's, for a run. A served machine makes one for each program.
    pub scheduler: Option<Scheduler>,
}

impl SignalEnds {
    /// For a run; `trace_length` is the capacity of the queue to the trace.
    pub(crate) fn of_run(job: &Job, trace_length: usize) -> Self {
        let settings = &job.setup.machine.signals;
        let on_bus = job.bus && !settings.is_empty();
        let script = (!on_bus || !job.is_realtime()).then(|| {
            let script = job.inputs.clone();
            script.unwrap_or_else(|| InputScript::without_file(settings))
        });
        let (scheduler, scheduled) = schedule();
        let mut signals = signals(&job.setup);
        let _none_before = signals.begin_program(scheduled);
        let is_recorded = job.trace.is_some() && !settings.is_empty();
        let trace_length = is_recorded.then_some(trace_length);
        let ends = Self::new(
            &job.setup,
            signals,
            (on_bus, script),
            trace_length,
            job.is_realtime(),
        );
        Self {
            scheduler: Some(scheduler),
            ..ends
        }
    }

    /// For a served machine; `trace_length` is the capacity of the queue to the trace, if there is one.
    pub(crate) fn of_service(setup: &Setup, trace_length: Option<usize>) -> Self {
        if setup.machine.signals.is_empty() {
            let script = InputScript::without_file(&setup.machine.signals);
            return Self::new(setup, signals(setup), (false, Some(script)), None, true);
        }
        Self::new(setup, signals(setup), (true, None), trace_length, true)
    }

    fn new(
        setup: &Setup,
        signals: Signals,
        (bus, script): (bool, Option<InputScript>),
        trace_length: Option<usize>,
        is_realtime: bool,
    ) -> Self {
        let settings: &SignalSettings = &setup.machine.signals;
        let (to_trace, recorded) = optional_ring(trace_length.is_some(), trace_length.unwrap_or(0));
        let (to_bus, changes) = optional_ring(bus, CHANGES);
        let (from_bus, samples) = optional_ring(bus, SAMPLES);
        let source = match (script, samples) {
            (None, Some(samples)) => InputSource::Bus(samples),
            (script, _) => {
                let script = script.unwrap_or_else(|| InputScript::without_file(settings));
                InputSource::Script(Box::new(script))
            }
        };
        Self {
            port: from_bus.zip(changes).map(|(samples, changes)| {
                SignalPort::new(settings, setup.period_ns, setup.tool, samples, changes)
            }),
            recorder: recorded.map(|changes| SignalRecorder::new(changes, settings.clone())),
            cycle: Some(SignalLoop::new(signals, source, to_bus, to_trace, is_realtime)),
            scheduler: None,
        }
    }
}

fn signals(setup: &Setup) -> Signals {
    let machine = &setup.machine;
    Signals::new(
        &machine.signals,
        machine.lead_cycles(setup.period_ns),
        setup.period_ns,
    )
}
