//! Clients that send valid commands as fast as they can do not delay other clients.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientConfig, ControlClient, ControlRequest};
use evolvent_replay::verify;
use evolvent_tests::{Scene, command, speed, unless_disturbed};

/// Clients that change the feed override.
const CLIENTS: usize = 3;
/// Maximum time from the command to the first setpoint that brakes: two polls of the control thread, a cycle,
/// the lead of 2 ms, and the reply.
const MAX_UNTIL_BRAKING: Duration = Duration::from_millis(40);

/// Ends the flood.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Changes the feed override up and down without waiting for replies, until `is_over`.
fn floods(scene: &Scene, is_over: &AtomicBool, sent: &AtomicU64) {
    let config = ClientConfig {
        prefix: Some(scene.domain.prefix.clone()),
        ..ClientConfig::new(scene.name())
    };
    // Without clients nothing is sent, which the test notices.
    let Ok(mut client) = ControlClient::open(&config) else {
        return;
    };
    while !is_over.load(Ordering::Relaxed) {
        for percent in 0..40_u8 {
            let turn = ControlRequest {
                amount: 0.8 + f64::from(percent) / 100.0,
                ..command("FEED_OVERRIDE")
            };
            // Does not wait: a command that does not fit into the connection is not sent.
            let _no_answer = client.command(&turn, Duration::ZERO);
            sent.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_micros(100));
    }
}

#[test]
fn an_emergency_stop_in_a_flood_acts_at_once() {
    unless_disturbed(|| {
        let mut scene = Scene::with("flood", &["--trace-limit", "1"]);
        let (is_over, sent) = (AtomicBool::new(false), AtomicU64::new(0));
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let flooded = operator.says_text("MDI", "G1 X300 F2400").job;
        operator.follows(|_| {}, |setpoint| speed(setpoint) > 25.0);
        std::thread::scope(|scope| {
            // Also if something panics here.
            let _over = SetOnDrop(&is_over);
            for _ in 0..CLIENTS {
                scope.spawn(|| floods(&scene, &is_over, &sent));
            }
            std::thread::sleep(Duration::from_millis(1500));
            let begin = Instant::now();
            operator.says("ESTOP");
            let answered = begin.elapsed();
            let mut fastest = 0.0_f64;
            // Overrides change the speed as well, but never below 0.8 times the feed.
            operator.follows(
                |setpoint| fastest = fastest.max(speed(setpoint)),
                |setpoint| speed(setpoint) < 20.0,
            );
            let braked = begin.elapsed();
            assert!(sent.load(Ordering::Relaxed) > 10_000, "no flood");
            println!("{sent:?} overrides; answered after {answered:?}, brakes after {braked:?}");
            assert!(fastest > 25.0, "it moved: {fastest}");
            assert!(braked < MAX_UNTIL_BRAKING, "{braked:?}");
        });
        let status = operator.waits("rest without power", |status| {
            status.velocity == [0.0; 9] && status.power == 0
        });
        assert_eq!((status.machine_state, status.alarm_count), (0, 0));
        // The axes are at rest before the core has ended the job.
        operator.sees_end(flooded);
        // Later commands take effect.
        operator.brings_up();
        let job = operator.says_text("MDI", "G91 G1 X-5 F6000").job;
        assert_eq!(operator.sees_end(job).job_result, 1);
        drop(operator);
        let finished = scene.served.take().expect("a core").end().expect_code(&[0, 3]);
        let trace = finished.json()["trace"].as_str().expect("a trace").to_owned();
        let verified = verify(trace.as_ref()).expect("a readable trace");
        assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
    });
}
