//! `evolvent bridge`: simulated drives, EtherCAT drives, Mesa boards, and a test suite for drive bridges.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{Args, Subcommand};
use evolvent_bridge_sim::{
    Cutting, Fault, LoopbackInputs, ProbeSettings, RunError, RunSettings, ServoSettings, Signalling, SimAxis,
    SimEvent, SimIndex, SimReport, SimSettings, SpindleSimulation, loopback, run_cutting,
};
use evolvent_bridge_test::run_core;
use evolvent_bus::{AXES, BusError, MachineInputs, MachineOutputs, Setpoint};
use evolvent_config::plain;
use evolvent_machine::{HomingMethod, HomingSettings, Machine, SignalKind};
use evolvent_runtime::{InputScript, RealtimeRequest, apply_to_this_thread};
use evolvent_turning::{SimulatedProcess, TurningJob};
use serde_json::json;
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

use crate::bridge_ethercat as ethercat;
use crate::bridge_mesa as mesa;
use crate::bridge_test;
use crate::output::written;
use crate::{CommandError, Ending};

/// Real-time priority of simulated drives, if the system permits it; below that of the core.
const PRIORITY: u8 = 40;

/// Distance between two index pulses of a simulated encoder, as a fraction of the distance within which
/// homing expects one. The switch closes in the middle between two pulses.
const PITCH_FRACTION: f64 = 0.75;
const SWITCH_FRACTION: f64 = 0.5 * PITCH_FRACTION;

/// Options of `evolvent bridge`.
#[derive(Args, Debug)]
pub(crate) struct BridgeArgs {
    #[command(subcommand)]
    command: BridgeCommand,
}

#[derive(Debug, Subcommand)]
enum BridgeCommand {
    /// Simulate drives that follow the setpoints of a core, send feedback, and fail on demand.
    Sim(SimArgs),
    /// Use EtherCAT drives (CiA 402, cyclic synchronous position) as the axes of a machine.
    Ethercat(ethercat::EthercatArgs),
    /// Use a Mesa Ethernet board (HostMot2 over LBP16): step generators, analog servos and pins as the axes
    /// and signals of a machine.
    Mesa(mesa::MesaArgs),
    /// Test whether a drive bridge does what every bridge must do.
    ///
    /// The command after `--` starts the bridge. In it, `{name}` and `{prefix}` are replaced by the machine's
    /// name and the bus prefix, which are also in EVOLVENT_MACHINE_NAME and EVOLVENT_BUS_PREFIX. Without a
    /// command the simulated bridge is tested. The first of three axes X Y Z moves by some millimetres,
    /// slowly. Exit code 1 if a case failed; 3 if none did, but this host kept the bridge from running for so
    /// long that a case could not be measured. Ctrl-C and SIGTERM end the suite and its bridge.
    Test(bridge_test::TestArgs),
    /// Run a core that moves an axis to and fro, which `test` kills.
    #[command(hide = true)]
    Core(CoreArgs),
}

#[derive(Args, Debug)]
struct SimArgs {
    /// Name of the machine, if no machine file is given.
    #[arg(long, value_name = "NAME", required_unless_present = "machine")]
    machine_name: Option<String>,
    /// Machine file: axes, limits and grid of the drives. Without it typical values are used.
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Prefix of the bus's files, as for the core.
    #[arg(long, value_name = "PREFIX")]
    bus_prefix: Option<String>,
    /// Fault to simulate: late, silent, frozen, stuck, fault, off, jump, blocked, nan, wild or ahead,
    /// starting this many seconds after the drives came into operation; of the load sensor (--process):
    /// load-zero, load-lost, load-frozen, load-nan, load-saturated or load-negative; of spindles with
    /// feedback: spindle-fault, spindle-silent, spindle-slow or spindle-stall; of homing: switch-closed,
    /// switch-open, index-missing or absolute-lost. May be given several times.
    #[arg(long = "fault", value_name = "KIND@SECONDS[+DURATION][:AXIS]")]
    faults: Vec<Fault>,
    /// Time after which the bridge ends, in seconds. Default: at Ctrl-C.
    #[arg(long, value_name = "N")]
    seconds: Option<f64>,
    /// Rate by which the drives' clock is slower than the core's, in ppm.
    #[arg(
        long,
        value_name = "PPM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    drift_ppm: f64,
    /// Natural frequency of the position loops, in Hz.
    #[arg(long, value_name = "HZ", default_value_t = 40.0)]
    frequency: f64,
    /// Damping ratio of the position loops.
    #[arg(long, value_name = "RATIO", default_value_t = 0.9)]
    damping: f64,
    /// Number of periods for which motion continues when setpoints are missing. Default: 10, at least 2 ms.
    #[arg(long, value_name = "N")]
    bridge_cycles: Option<u32>,
    /// Error of the encoders' positions until the axes are homed, in mm or degrees.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    reference_offset: f64,
    /// Simulate absolute encoders: a homed machine stays homed when the bridge restarts.
    #[arg(long, requires = "machine")]
    absolute: bool,
    /// Process file of `evolvent turn`: the axes X and Z cut its stock, and its load sensor publishes every
    /// period.
    #[arg(long, value_name = "FILE.toml")]
    process: Option<PathBuf>,
    /// File of changes of the machine's inputs, as for `evolvent run --inputs`, from the first setpoint on.
    /// Without it only the emergency-stop chain is known, and closed.
    #[arg(long, value_name = "FILE.toml", requires = "machine")]
    inputs: Option<PathBuf>,
    /// Acceleration of spindles with feedback, in rpm per second.
    #[arg(long, value_name = "RPM_PER_S", default_value_t = 2000.0)]
    spindle_acceleration: f64,
    /// Ripple of the speed of these spindles, three periods per turn, in percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0)]
    spindle_ripple: f64,
    /// Counts per turn of the encoders of these spindles.
    #[arg(long, value_name = "N", default_value_t = 4096)]
    spindle_counts: u32,
    /// Age of the feedback of these spindles when it is sent, in ms.
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    spindle_delay: f64,
    /// Simulate a touch probe, given by the surfaces that it can touch in machine coordinates: plane:Z<-3,
    /// bore:X,Y,DIAMETER,TOP, boss:X,Y,DIAMETER,TOP or block:X1,X2,Y1,Y2,Z1,Z2; several are joined by +.
    /// Options follow after ; : delay=MS until the contact is reported, late=MS error of its time, bounces=N,
    /// lost=MS after which it stops sending, latched if the drives latch their positions.
    #[arg(long, value_name = "SURFACES[;...]")]
    probe: Option<ProbeSettings>,
    /// Wire each output to the input of the same number; the emergency-stop chain is closed. Without a
    /// machine file spindle 0 is simulated.
    #[arg(long, conflicts_with = "inputs")]
    loopback: bool,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

#[derive(Args, Debug)]
struct CoreArgs {
    #[arg(long)]
    machine_name: String,
    #[arg(long)]
    bus_prefix: String,
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
}

pub(crate) fn run(
    args: &BridgeArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    match &args.command {
        BridgeCommand::Sim(args) => sim(args, out, err),
        BridgeCommand::Ethercat(args) => ethercat::run(args, out, err),
        BridgeCommand::Mesa(args) => mesa::run(args, out, err),
        BridgeCommand::Test(args) => bridge_test::run(args, out, err),
        BridgeCommand::Core(args) => run_core(&args.machine_name, &args.bus_prefix, args.seconds)
            .map(|()| Ending::Clean)
            .map_err(|error| CommandError::Failed(error.to_string())),
    }
}

/// A flag that SIGINT, SIGTERM, SIGHUP and SIGQUIT set.
pub(crate) fn stop_on_signals() -> Result<Arc<AtomicBool>, CommandError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| CommandError::Failed(format!("signals cannot be caught: {error}")))?;
    }
    Ok(stop)
}

/// The duration of `--seconds`; `None` for no limit.
pub(crate) fn duration_of(seconds: Option<f64>) -> Result<Option<Duration>, CommandError> {
    match seconds {
        None => Ok(None),
        Some(seconds) if (0.0..=1e9).contains(&seconds) => Ok(Some(Duration::from_secs_f64(seconds))),
        Some(seconds) => Err(CommandError::Usage(format!(
            "--seconds {seconds} is out of range: choose 0 to 1000000000"
        ))),
    }
}

/// The ending of a hardware bridge: a failure if its time is over and the hardware never came up.
pub(crate) fn ending_of_bridge(
    seconds: Option<f64>,
    stop: &AtomicBool,
    (connections, ready): (u32, u64),
    hardware: &str,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let Some(seconds) = seconds.filter(|_| ready == 0 && !stop.load(Ordering::Relaxed)) else {
        return Ok(Ending::Clean);
    };
    let why = if connections == 0 {
        "no core was running, and it waits for one: start `evolvent serve` or `evolvent run` for this machine"
    } else {
        "see the messages above"
    };
    written(writeln!(
        err,
        "{hardware} did not come up within {seconds} s: {why}"
    ))?;
    Ok(Ending::Negative)
}

fn sim(args: &SimArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    let usage = |text: String| CommandError::Usage(text);
    let duration = checked_ranges(args)?;
    let machine = match &args.machine {
        Some(file) => Some(Machine::load(file).map_err(|error| usage(error.to_string()))?),
        None => None,
    };
    let drives = match &machine {
        Some(machine) => Some(drives_of(machine, args).map_err(usage)?),
        None => None,
    };
    let signalling = signalling_of(args, machine.as_ref())?;
    let name = args
        .machine_name
        .clone()
        .or_else(|| machine.as_ref().map(|machine| machine.name.clone()))
        .unwrap_or_default();
    let spindles = match &machine {
        Some(machine) => spindles_of(machine, args),
        // As required by the test suite of all bridges.
        None if args.loopback => vec![SpindleSimulation::usual(0)],
        None => Vec::new(),
    };
    let settings = RunSettings {
        spindles,
        machine_name: name.clone(),
        prefix: args.bus_prefix.clone(),
        drives,
        faults: args.faults.clone(),
        probe: args.probe.clone(),
        drift_ppm: args.drift_ppm,
        duration,
    };
    let process = args
        .process
        .as_deref()
        .map(evolvent_analysis::read_process)
        .transpose()?;
    if let (Some(file), Some(job)) = (&args.process, &process)
        && job.blank.is_none()
    {
        return Err(usage(format!(
            "{}: has no [stock], so there is nothing to cut: add one, or omit --process",
            file.display()
        )));
    }
    let stop = stop_on_signals()?;
    let tell = |event: &SimEvent| {
        // If standard error is closed, nobody is left to inform.
        let _told = match event {
            SimEvent::Waiting => writeln!(err, "simulated drives of {name}: {event}"),
            event => writeln!(err, "{event}"),
        };
    };
    // Late feedback and loads stop a machine like a broken cable.
    let _granted = apply_to_this_thread(&RealtimeRequest {
        priority: Some(PRIORITY),
        ..RealtimeRequest::default()
    });
    let report = run_cutting(
        &settings,
        &stop,
        tell,
        |period_ns| process.and_then(|job| cutting(&job, period_ns)),
        signalling,
    );
    let report = report.map_err(|error| match error {
        RunError::Bus(BusError::Name(_) | BusError::Prefix { .. }) | RunError::Settings(_) => {
            usage(error.to_string())
        }
        RunError::Bus(_) => CommandError::Failed(error.to_string()),
    })?;
    report_sim(args, &name, &report, out, err)
}

/// Checks the ranges of all numbers. Returns the duration; `None` for no limit.
fn checked_ranges(args: &SimArgs) -> Result<Option<Duration>, CommandError> {
    let usage = |text: String| CommandError::Usage(text);
    let within = |name: &str, value: f64, min: f64, max: f64| {
        if (min..=max).contains(&value) {
            return Ok(());
        }
        Err(usage(format!(
            "--{name} {} is out of range: choose {min} to {max}",
            plain(value)
        )))
    };
    within("frequency", args.frequency, 0.1, 10_000.0)?;
    within("damping", args.damping, 0.01, 100.0)?;
    within("drift-ppm", args.drift_ppm, -10_000.0, 10_000.0)?;
    within("reference-offset", args.reference_offset, -1e6, 1e6)?;
    within("spindle-acceleration", args.spindle_acceleration, 1.0, 1e9)?;
    within("spindle-ripple", args.spindle_ripple, 0.0, 50.0)?;
    within("spindle-counts", f64::from(args.spindle_counts), 1.0, 1e9)?;
    within("spindle-delay", args.spindle_delay, 0.0, 1000.0)?;
    duration_of(args.seconds)
}

/// The simulated reaction to outputs, and the inputs that the bridge sends.
fn signalling_of(args: &SimArgs, machine: Option<&Machine>) -> Result<Option<Signalling>, CommandError> {
    let signalling: Option<Signalling> = match machine {
        _ if args.loopback => Some(loopback(machine.map_or_else(LoopbackInputs::all, looped_inputs))),
        Some(machine) if !machine.signals.inputs.is_empty() => Some(signalling(
            crate::program::inputs(args.inputs.as_deref(), machine)?
                .unwrap_or_else(|| InputScript::without_file(&machine.signals)),
        )),
        _ if args.probe.is_some() => Some(Box::new(|_: Option<&Setpoint>, _: &MachineOutputs| {
            MachineInputs::default()
        })),
        _ => None,
    };
    Ok(signalling)
}

fn report_sim(
    args: &SimArgs,
    name: &str,
    report: &SimReport,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    if args.json {
        let object = json!({
            "machine": name,
            "periods": report.periods,
            "setpoints": report.setpoints,
            "missed": report.missed,
            "answers": report.answers,
            "loads": report.loads,
            "inputs": report.inputs,
            "spindles": report.spindles,
            "connections": report.connections,
        });
        written(writeln!(out, "{object}"))?;
    } else {
        written(writeln!(
            err,
            "{} setpoints in {} periods, {} missed, {} answers",
            report.setpoints, report.periods, report.missed, report.answers
        ))?;
    }
    Ok(Ending::Clean)
}

/// The spindles of a machine that have feedback.
fn spindles_of(machine: &Machine, args: &SimArgs) -> Vec<SpindleSimulation> {
    let spindles = machine.signals.spindles.iter();
    spindles
        .filter(|spindle| spindle.has_feedback())
        .map(|spindle| SpindleSimulation {
            number: spindle.number,
            acceleration_rpm_s: args.spindle_acceleration,
            ripple: args.spindle_ripple / 100.0,
            counts: args.spindle_counts,
            delay_ns: (args.spindle_delay * 1e6) as u64,
        })
        .collect()
}

/// The stock of a turning job, cut by the axes.
fn cutting(job: &TurningJob, period_ns: u64) -> Option<Cutting> {
    let mut process = SimulatedProcess::new(job, period_ns as f64 * 1e-9)?;
    Some(Box::new(move |position: &[f64; AXES]| {
        let (_, sample) = process.step(position[0], position[2]);
        sample.map(|sample| (sample.value, sample.range_max))
    }))
}

/// Inputs from a file, by the time since the first setpoint.
fn signalling(mut script: InputScript) -> Signalling {
    let (mut now, mut first_ns) = (MachineInputs::default(), None);
    Box::new(move |setpoint: Option<&Setpoint>, _: &MachineOutputs| {
        let seconds = setpoint.map_or(0.0, |setpoint| {
            let first_ns = *first_ns.get_or_insert(setpoint.due_time_ns);
            setpoint.due_time_ns.saturating_sub(first_ns) as f64 * 1e-9
        });
        let progress = setpoint.map(|setpoint| (setpoint.path_mm, setpoint.line));
        // One change at a time: a value that changes and changes back immediately is sent as both.
        if let Some(image) = script.step(seconds, progress) {
            (now.digital_mask, now.digital) = (image.digital_known, image.digital);
            (now.analog_mask, now.analog) = (image.analog_known, image.analog);
        }
        now
    })
}

/// The inputs of a machine file, for outputs that are wired to them.
fn looped_inputs(machine: &Machine) -> LoopbackInputs {
    let mut inputs = LoopbackInputs {
        digital: 0,
        analog: 0,
        closed: closed_chain(machine),
        ..LoopbackInputs::all()
    };
    for input in &machine.signals.inputs {
        match input.kind {
            SignalKind::Digital => inputs.digital |= 1 << input.number,
            SignalKind::Analog => {
                inputs.analog |= 1 << input.number;
                inputs.ranges[input.number as usize] = input.range;
            }
        }
    }
    inputs
}

/// The input of a machine's emergency-stop chain, if it is on while the chain is closed.
fn closed_chain(machine: &Machine) -> u64 {
    let chain = machine.signals.estop.filter(|estop| estop.closed);
    chain.map_or(0, |estop| 1 << estop.input)
}

/// Drives with limits slightly above those of the machine file, to allow for the rounding that the guard of
/// the core permits.
fn drives_of(machine: &Machine, args: &SimArgs) -> Result<SimSettings, String> {
    let period_ns = machine
        .period_ns(machine.rate)
        .map_err(|error| error.to_string())?;
    let increments = machine.increments();
    let mut settings = SimSettings::usual("", period_ns);
    settings.bridge_cycles = args.bridge_cycles;
    settings.absolute = args.absolute;
    for axis in &machine.axes {
        let index = axis.letter.index();
        let range = axis.travel_max - axis.travel_min;
        let homing = machine.homing.iter().find(|homing| homing.axis == axis.letter);
        settings.axes.push(SimAxis {
            axis: index,
            max_velocity: axis.max_velocity,
            max_acceleration: axis.max_acceleration,
            max_jerk: axis.max_jerk,
            travel_min: axis.travel_min,
            travel_max: axis.travel_max,
            start: axis.home,
            reference_offset: args.reference_offset,
            home_switch: homing.map_or(axis.travel_min + 0.02 * range, home_switch),
            home_switch_is_below: homing.is_none_or(|homing| homing.negative),
            search_velocity: homing.map_or(0.0, |homing| homing.search_velocity),
            unlimited: axis.unlimited.is_some(),
            index: homing.and_then(index_pulses),
            encoder_step: 0.1 / increments[index].max(1e-3),
            servo: ServoSettings {
                natural_frequency_hz: args.frequency,
                damping: args.damping,
                feed_forward: 0.9,
                strongest: 2.0 * axis.max_acceleration,
            },
        });
        settings.sync_tolerance = settings.sync_tolerance.min(axis.following_error);
    }
    Ok(settings)
}

/// The position at which the home switch of a simulated axis closes, so that homing finds the value in its
/// table.
fn home_switch(homing: &HomingSettings) -> f64 {
    match homing.method {
        HomingMethod::SwitchThenIndex { when_opening, within } => {
            let is_found_downwards = homing.negative != when_opening;
            let before = within * SWITCH_FRACTION;
            homing.reference + if is_found_downwards { before } else { -before }
        }
        _ => homing.reference,
    }
}

/// The index pulses of the axis's encoder, chosen in the same way.
fn index_pulses(homing: &HomingSettings) -> Option<SimIndex> {
    match homing.method {
        HomingMethod::SwitchThenIndex { within, .. } | HomingMethod::Index { within } => Some(SimIndex {
            position: homing.reference,
            pitch: within * PITCH_FRACTION,
        }),
        HomingMethod::Switch | HomingMethod::Absolute => None,
    }
}
