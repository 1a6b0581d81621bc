//! The same program on the same machine gives the same setpoints, bit for bit, with any clock.

use std::path::Path;

use evolvent_tests::{
    Cycle, Domain, Finished, Launch, Workshop, cycles, evolvent, repository, unless_disturbed,
};

/// Every computed (not measured) field of a cycle, as bits.
fn bits(cycle: &Cycle) -> Vec<u64> {
    let vectors = [cycle.position, cycle.velocity, cycle.acceleration, cycle.jerk];
    let numbers = [cycle.path_mm, cycle.feed_mm_s, cycle.override_];
    let words = [cycle.sequence, u64::from(cycle.line), u64::from(cycle.state)];
    words
        .into_iter()
        .chain(
            vectors
                .iter()
                .flatten()
                .chain(&numbers)
                .map(|value| value.to_bits()),
        )
        .collect()
}

#[track_caller]
fn assert_same(one: &Path, other: &Path) {
    let (one, other) = (cycles(one), cycles(other));
    assert_eq!(one.len(), other.len(), "cycles");
    for (a, b) in one.iter().zip(&other) {
        assert_eq!(bits(a), bits(b), "cycle {}", a.sequence);
    }
}

#[test]
fn real_and_virtual_clock_give_the_same_bits() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let workshop = Workshop::new();
        let (program, machine) = (workshop.short_program(), workshop.mill("clocks", &[]));
        let traces = ["realtime.mcap", "virtual.mcap"].map(|name| workshop.path(name));
        Launch::in_real_time(&program, &machine, &domain)
            .trace(&traces[0])
            .finish()
            .expect_code(&[0, 3]);
        Launch::in_virtual_time(&program, &machine)
            .trace(&traces[1])
            .finish()
            .expect_code(&[0]);
        assert_same(&traces[0], &traces[1]);
    });
}

#[test]
fn two_virtual_runs_give_the_same_bits() {
    let workshop = Workshop::new();
    let machine = repository().join("config/machines/mill-3axis.toml");
    for program in ["bore-200", "facing-inch", "pocket-helix", "relief"] {
        let file = repository().join(format!("tests/programs/{program}.ngc"));
        let traces = [1, 2].map(|number| {
            let trace = workshop.path(&format!("{program}-{number}.mcap"));
            Launch::in_virtual_time(&file, &machine)
                .trace(&trace)
                .finish()
                .expect_code(&[0]);
            trace
        });
        assert_same(&traces[0], &traces[1]);
    }
}

/// A plan is a run without listeners: its table contains the setpoints of the run, to the last digit.
#[test]
fn the_table_of_a_plan_holds_the_setpoints_of_the_run() {
    let workshop = Workshop::new();
    let (program, machine) = (workshop.short_program(), workshop.mill("table", &[]));
    let (table, trace) = (workshop.path("table.csv"), workshop.path("run.mcap"));
    let mut plan = evolvent();
    plan.arg("plan")
        .arg(&program)
        .arg("--machine")
        .arg(&machine)
        .arg("--setpoints")
        .arg(&table);
    Finished::from(plan.output().expect("the binary to start")).expect_code(&[0]);
    Launch::in_virtual_time(&program, &machine)
        .trace(&trace)
        .finish()
        .expect_code(&[0]);
    let text = std::fs::read_to_string(&table).expect("the table");
    let mut rows = text.lines();
    let head: Vec<&str> = rows.next().expect("a head").split(',').collect();
    let column = |name: &str| head.iter().position(|word| *word == name).expect("a column");
    let columns = [column("X_mm"), column("Y_mm"), column("Z_mm")];
    let recorded = cycles(&trace);
    assert_eq!(rows.clone().count(), recorded.len());
    for (row, cycle) in rows.zip(&recorded) {
        let cells: Vec<&str> = row.split(',').collect();
        for (axis, column) in columns.into_iter().enumerate() {
            let value: f64 = cells[column].parse().expect("a number");
            assert_eq!(
                value.to_bits(),
                cycle.position[axis].to_bits(),
                "cycle {}",
                cycle.sequence
            );
        }
    }
}
