//! The spindle override of a served lathe: disabled while motion follows the spindle, and never above D of
//! G96.

use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, MachineOutputs};
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Domain, Drives, Operator, OutputListener, Served, Workshop, command, unless_disturbed};

/// A busy host may be slow.
const PATIENCE: Duration = Duration::from_secs(60);

const SPINDLES: &str = "
[[spindle]]
max_rpm = 4000
feedback = true
acceleration_rpm_s = 2000
[[spindle]]
number = 1
max_rpm = 2000
feedback = true
acceleration_rpm_s = 2000
";

fn speed(message: &MachineOutputs) -> f64 {
    match message.spindle_direction[1] {
        1 => message.spindle_rpm[1],
        2 => -message.spindle_rpm[1],
        _ => 0.0,
    }
}

/// Waits until spindle 1 is commanded this speed.
fn reach(listener: &OutputListener, wanted: f64) {
    let begin = Instant::now();
    loop {
        let last = listener.messages().last().map(speed);
        if last == Some(wanted) {
            return;
        }
        assert!(begin.elapsed() < PATIENCE, "{wanted} rpm do not come: {last:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn runs(operator: &mut Operator, block: &str) {
    let job = operator.says_text("MDI", block).job;
    let ended = operator.sees_end(job);
    assert_eq!(ended.job_result, DONE, "{block}: {}", ended.alarm_sentence());
}

fn overrides_spindles(operator: &mut Operator, ratio: f64) {
    operator.does(&ControlRequest {
        amount: ratio,
        ..command("SPINDLE_OVERRIDE")
    });
}

#[test]
fn taps_and_threads_ignore_the_spindle_override() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let name = "served-threads";
        let machine = workshop.lathe(name, SPINDLES);
        let _drives = Drives::start(&machine, &domain, &[]);
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join(name, &domain);
        let listener = OutputListener::of(&domain, name);
        operator.brings_up();
        operator.says_number("MODE", 2);
        runs(&mut operator, "G21 G18 G90 G8 G94 F600 S300 M3 $1");
        runs(&mut operator, "G0 X20 Z10");
        for (ratio, cut) in [
            (1.6, "G33.1 Z-5 K1 $1"),
            (0.4, "G33.1 Z-5 K1 $1"),
            (0.15, "G33 Z0 K1 $1"),
            // Spindle 0 is stopped: without `$` the thread uses the spindle of the previous block.
            (0.4, "G33 Z0 K1"),
            (2.0, "G33 Z-10 K1 $1"),
        ] {
            overrides_spindles(&mut operator, ratio);
            reach(&listener, ratio * 300.0);
            let from = listener.messages().len();
            runs(&mut operator, cut);
            let speeds: Vec<f64> = listener.messages()[from..].iter().map(speed).collect();
            let is_programmed = speeds.contains(&300.0);
            assert!(is_programmed, "{cut} at {ratio}: {speeds:?}");
            assert_eq!(speeds.contains(&-300.0), cut.starts_with("G33.1"), "{cut}");
            // The block is over, and the override is enabled again.
            reach(&listener, ratio * 300.0);
            runs(&mut operator, "G0 Z10");
        }
        // The status contains the commanded and the measured speed of each spindle.
        overrides_spindles(&mut operator, 1.0);
        operator.waits("both spindles", |status| {
            let spindles: Vec<_> = status.spindles().collect();
            let is_measured = |at: usize, rpm: f64| {
                let measured = spindles[at].measured_rpm;
                measured.is_some_and(|measured| (measured - rpm).abs() < 10.0)
            };
            let commands: Vec<f64> = spindles.iter().map(|spindle| spindle.command_rpm).collect();
            commands == [0.0, 300.0] && is_measured(0, 0.0) && is_measured(1, 300.0)
        });
        // 50 m/min at a radius of 20 mm are 398 rpm, and 597 at 150 %: D limits it to 450.
        overrides_spindles(&mut operator, 1.5);
        runs(&mut operator, "G96 S50 D450 $1");
        runs(&mut operator, "G1 X20 F600");
        reach(&listener, 450.0);
        overrides_spindles(&mut operator, 1.0);
        let exact = 50_000.0 / (std::f64::consts::TAU * 20.0);
        let begin = Instant::now();
        while !listener
            .messages()
            .last()
            .map(speed)
            .is_some_and(|rpm| (rpm / exact - 1.0).abs() < 0.002)
        {
            assert!(begin.elapsed() < PATIENCE, "{exact} rpm do not come");
            std::thread::sleep(Duration::from_millis(2));
        }
        let max_rpm = listener
            .messages()
            .iter()
            .map(speed)
            .skip_while(|rpm| *rpm != 450.0)
            .fold(0.0, f64::max);
        assert!(max_rpm <= 450.0, "{max_rpm} rpm");
        served.end().expect_code(&[0, 1, 3]);
    });
}
