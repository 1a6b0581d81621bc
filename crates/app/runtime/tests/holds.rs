//! A hold takes at most 1.15 times the shortest stop on that path plus 15 ms, with the planner running or
//! frozen. The shortest stops were computed by another method (`examples/shortest_stop.py`, linear programs
//! that know the whole path).
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may fail, and says how near it was"
)]

use std::path::{Path, PathBuf};

use crate::common::driven::{Driven, set_up};

/// `program,machine,rate_hz,moment,is_frozen,feed_mm_s,shortest_s,method`. If the bound holds for the slowest
/// axis alone, its time is used as the shortest (method `axis`).
const TABLE: &str = include_str!("shortest_stops.csv");
const FACTOR: f64 = 1.15;
const EXTRA_S: f64 = 0.015;

/// One hold of the table.
struct Hold<'a> {
    program: &'a str,
    machine: &'a str,
    rate_hz: f64,
    moment: usize,
    is_frozen: bool,
    feed_mm_s: f64,
    shortest_s: f64,
}

impl<'a> Hold<'a> {
    fn read(row: &'a str) -> Self {
        let cells: Vec<&str> = row.split(',').collect();
        let [program, machine, rate, moment, is_frozen, feed, shortest, _method] = cells[..] else {
            panic!("a row of eight cells: {row}");
        };
        Self {
            program,
            machine,
            rate_hz: rate.parse().expect("a rate"),
            moment: moment.parse().expect("a setpoint"),
            is_frozen: is_frozen.parse().expect("true or false"),
            feed_mm_s: feed.parse().expect("a feed"),
            shortest_s: shortest.parse().expect("a time"),
        }
    }

    /// The program: shipped, or LinuxCNC's own if installed.
    fn program(&self) -> Option<PathBuf> {
        let shipped = repository().join("tests/programs").join(self.program);
        if shipped.exists() {
            return Some(shipped);
        }
        let fetched = PathBuf::from(std::env::var_os("EVOLVENT_LINUXCNC")?);
        Some(fetched.join("nc_files").join(self.program))
    }
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// Runs the holds of some programs. Returns the largest ratio of time (without the 15 ms) to the shortest
/// stop.
fn drive(is_wanted: impl Fn(&str) -> bool) {
    let rows = TABLE
        .lines()
        .filter(|row| !row.starts_with('#') && is_wanted(row));
    let mut worst: f64 = 0.0;
    let mut count = 0;
    for row in rows {
        let hold = Hold::read(row);
        let Some(program) = hold.program() else {
            println!("not measured: no EVOLVENT_LINUXCNC (run tools/test on Debian)");
            return;
        };
        let setup = set_up(
            &repository().join("config/machines").join(hold.machine),
            hold.rate_hz,
        );
        let held = Driven::new(&program, &setup, setup.period_ns).held(hold.moment, hold.is_frozen);
        let feed_mm_s = held[hold.moment - 1].feed_mm_s;
        assert!(
            (feed_mm_s - hold.feed_mm_s).abs() <= 0.01 * hold.feed_mm_s + 0.01,
            "the plan of {row} has changed, {feed_mm_s} mm/s there: compute the table again \
             (examples/shortest_stop.py)"
        );
        let took_s = (held.len() - hold.moment) as f64 / hold.rate_hz;
        let ratio = (took_s - EXTRA_S) / hold.shortest_s;
        assert!(ratio <= FACTOR, "{row}: {took_s} s, {ratio} times the shortest");
        worst = worst.max(ratio);
        count += 1;
    }
    assert!(count > 0, "no holds");
    println!("{count} holds: but for 15 ms at most {worst:.3} times the shortest");
}

#[test]
fn holds_of_shipped_programs_are_nearly_the_shortest() {
    drive(|row| !row.starts_with("3D_Chips"));
}

#[test]
fn holds_of_a_dense_contour_are_nearly_the_shortest() {
    drive(|row| row.starts_with("3D_Chips"));
}
