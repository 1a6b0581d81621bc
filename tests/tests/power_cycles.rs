//! OFF, and ON shortly after it: the machine is on again, with any drives.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_runtime::MonotonicClock;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{
    Domain, Drives, HardwareBridge, Lathe, MesaLathe, Operator, Random, RingLathe, Served, Workshop, command,
    where_undisturbed,
};

const ON: u32 = 2;
const TIMES: u32 = 50;
/// A bridge that is suspended for ten periods brakes on its own, as it must: a pause of three quarters of
/// that explains it.
const SUSPENDED: Duration = Duration::from_millis(30);

/// Switches off and on, 0 to 50 ms apart; in some cases an axis moves at once.
fn switches_off_and_on(operator: &mut Operator, random: &mut Random) {
    operator.brings_up();
    operator.says_number("MODE", 1);
    for time in 0..TIMES {
        operator.says("OFF");
        // One case in five moves as soon as the command is accepted.
        if time % 5 != 0 {
            std::thread::sleep(Duration::from_secs_f64(random.between(0.0, 0.05)));
        }
        operator.says("ON");
        // An earlier status may still report that it is on.
        let ordered_ns = MonotonicClock::now_ns();
        let status = operator.waits("power", |status| {
            status.time_ns > ordered_ns && (status.machine_state == ON || status.alarm_count > 0)
        });
        assert_on(&status, time);
        if time % 10 == 0 {
            let mut jog = ControlRequest {
                axes_mask: 1,
                index: 1,
                amount: 10.0,
                ..command("JOG")
            };
            jog.values[0] = if time % 20 == 0 { 0.5 } else { -0.5 };
            let job = operator.does(&jog).job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, DONE, "{time}: {}", status.alarm_sentence());
        }
        std::thread::sleep(Duration::from_millis(10));
        assert_on(&operator.now(), time);
    }
}

fn assert_on(status: &Status, time: u32) {
    let what = (status.machine_state, status.enabled_mask, status.alarm_count);
    assert_eq!(
        what,
        (ON, status.axes_mask, 0),
        "time {time}: {}",
        status.alarm_sentence()
    );
}

/// A served machine with drives that `start` creates for it.
fn serve<D>(machine: &Path, name: &str, workshop: &Workshop, start: impl FnOnce(&Domain) -> D) {
    let domain = Domain::new();
    let _served = Served::start(machine, name, &domain, &workshop.path("state"), &[]);
    let mut operator = Operator::join(name, &domain);
    let drives = start(&domain);
    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
    switches_off_and_on(&mut operator, &mut Random::new());
    drop(drives);
}

fn lathe_switches_off_and_on(lathe: impl Fn() -> Arc<dyn Lathe>) {
    where_undisturbed(SUSPENDED, || {
        let (lathe, workshop) = (lathe(), Workshop::new());
        let machine = workshop.lathe("switched-lathe", "[[spindle]]\nmax_rpm = 3000\nfeedback = true\n");
        let text = std::fs::read_to_string(machine).expect("a machine file");
        let text = text.replace("rate = 1000\n", "rate = 250\nlead_cycles = 10\n");
        let machine = workshop.write("switched.toml", text);
        serve(&machine, "switched-lathe", &workshop, |domain| {
            HardwareBridge::start(&lathe.bridge(&workshop), &machine, domain)
        });
    });
}

#[test]
fn a_lathe_on_ethercat_is_on_after_off_and_on() {
    RingLathe::on_ring(|lathe| lathe_switches_off_and_on(lathe));
}

#[test]
fn a_lathe_on_a_mesa_board_is_on_after_off_and_on() {
    lathe_switches_off_and_on(|| Arc::new(MesaLathe::start().with_lost_packets(13)));
}

#[test]
fn a_mill_on_simulated_drives_is_on_after_off_and_on() {
    where_undisturbed(SUSPENDED, || {
        let workshop = Workshop::new();
        let changes = [("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 300 ")];
        let machine = workshop.mill("switched-mill", &changes);
        serve(&machine, "switched-mill", &workshop, |domain| {
            Drives::start(&machine, domain, &[])
        });
    });
}
