//! One name, one core: machines with different names run concurrently, and a second core with the same name
//! is rejected.

use std::time::{Duration, Instant};

use evolvent_tests::{Domain, Launch, Workshop, unless_disturbed, wait};

#[test]
fn two_machines_side_by_side_have_their_own_clients() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let workshop = Workshop::new();
        let program = workshop.short_program();
        let other = workshop.write("other.ngc", "G21 G90 G94 G61 F3000\nG1 X40\nG1 X0\nM30\n");
        let [left, right] = [("left", &program), ("right", &other)].map(|(name, program)| {
            let machine = workshop.mill(name, &[]);
            let options = ["--wait-for-clients", "1"];
            Launch::in_real_time(program, &machine, &domain)
                .no_trace()
                .with(&options)
                .start()
        });
        let mut readers =
            ["left", "right"].map(|name| domain.client(name).setpoints().expect("a subscription"));
        let (mut counts, mut max_y) = ([0_u64; 2], [0.0_f64; 2]);
        let summaries = std::thread::scope(|scope| {
            let ends = [left, right].map(|process| scope.spawn(|| wait(process)));
            loop {
                let over = ends.iter().all(std::thread::ScopedJoinHandle::is_finished);
                for (i, reader) in readers.iter_mut().enumerate() {
                    while let Some(setpoint) = reader.receive().expect("the bus") {
                        assert_eq!(setpoint.sequence, counts[i], "reader {i}");
                        counts[i] += 1;
                        max_y[i] = max_y[i].max(setpoint.position[1].abs());
                    }
                }
                if over {
                    break;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            ends.map(|end| end.join().expect("a run").expect_code(&[0, 3]).json())
        });
        assert_eq!(summaries[0]["cycles"], counts[0]);
        assert_eq!(summaries[1]["cycles"], counts[1]);
        assert!(
            max_y[0] > 9.0 && max_y[1] == 0.0,
            "{max_y:?}: only the left one moves in Y"
        );
    });
}

#[test]
fn a_second_core_of_one_name_is_rejected() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let workshop = Workshop::new();
        let (program, machine) = (workshop.long_program(60), workshop.mill("taken", &[]));
        let mut first = Launch::in_real_time(&program, &machine, &domain)
            .no_trace()
            .start();
        let mut reader = domain.client("taken").setpoints().expect("a subscription");

        let started = Instant::now();
        let trace = workshop.path("second.mcap");
        let second = Launch::in_real_time(&program, &machine, &domain)
            .trace(&trace)
            .finish();
        println!("refused after {:?}", started.elapsed());
        let second = second.expect_code(&[1]);
        assert_eq!(second.out, "", "no summary: it never ran");
        assert!(second.err.contains("taken"), "the name is in: {}", second.err);
        assert_eq!(workshop.files(), ["long.ngc", "taken.toml"], "no trace was begun");

        assert!(
            first.try_wait().expect("a process").is_none(),
            "the first goes on"
        );
        // It may still be planning, and a busy host is slow.
        let (begin, patience) = (Instant::now(), Duration::from_secs(60));
        let (mut next, mut received) = (None, 0);
        while received < 50 && begin.elapsed() < patience {
            while let Some(setpoint) = reader.receive().expect("the bus") {
                assert_eq!(
                    setpoint.sequence,
                    next.unwrap_or(setpoint.sequence),
                    "undisturbed"
                );
                next = Some(setpoint.sequence + 1);
                received += 1;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(received >= 50, "the first was heard {received} times");
        first.kill().expect("to end it");
        first.wait().expect("its end");
    });
}
