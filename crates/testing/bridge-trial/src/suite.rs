//! Runs the suite of all bridges on one bridge.

use evolvent_bridge_test::{BridgeUnderTest, CASES, Case, Outcome, Part, Stage, run_case};

/// Runs the given cases that need neither a spindle nor a probe, or the one that the environment variable
/// `EVOLVENT_CASE` names, on a bridge whose digital output 0 is wired to its digital input 0. Returns the
/// failed cases with the reasons. A case that leaves itself out has failed unless its name is in `left_out`.
/// Cases that kill a process are not run.
pub fn failed_cases(
    bridge: &mut dyn BridgeUnderTest,
    prefix: &str,
    cases: &[Case],
    left_out: &[&str],
) -> Vec<String> {
    play(bridge, prefix, cases, &[Part::Axes, Part::Signals], left_out)
}

/// Runs the spindle cases only, on a bridge that turns spindle 0.
pub fn failed_spindle_cases(bridge: &mut dyn BridgeUnderTest, prefix: &str) -> Vec<String> {
    play(bridge, prefix, &CASES, &[Part::Spindle], &[])
}

/// Runs the case of a touch probe only, on a bridge whose first axis makes contact 1 to 4 mm away.
pub fn failed_probe_cases(bridge: &mut dyn BridgeUnderTest, prefix: &str) -> Vec<String> {
    play(bridge, prefix, &CASES, &[Part::Probe], &[])
}

fn play(
    bridge: &mut dyn BridgeUnderTest,
    prefix: &str,
    cases: &[Case],
    parts: &[Part],
    left_out: &[&str],
) -> Vec<String> {
    let wanted = std::env::var("EVOLVENT_CASE").ok();
    let mut failures = Vec::new();
    for case in cases
        .iter()
        .filter(|case| parts.contains(&case.part) && !case.kills_core && !case.kills_bridge)
        .filter(|case| wanted.as_ref().is_none_or(|wanted| case.name == wanted))
    {
        let mut stage = Stage {
            bridge: &mut *bridge,
            machine_name: "bridge-test".to_owned(),
            prefix: prefix.to_owned(),
            core_program: None,
            seed: 1,
            moments: 2,
            parts,
            stop: Default::default(),
        };
        let result = run_case(case, &mut stage);
        println!("{}: {result:?}", case.name);
        failures.extend(match result {
            Ok(Outcome::LeftOut(why)) if !left_out.contains(&case.name) => {
                Some(format!("{}: left out: {why}", case.name))
            }
            result => result.err().map(|error| format!("{}: {error}", case.name)),
        });
        bridge.end();
    }
    failures
}
