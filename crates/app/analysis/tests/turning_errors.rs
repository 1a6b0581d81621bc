//! Errors of a turning trial name the job, not a temporary file.

use std::path::Path;

use evolvent_analysis::{TurningRoute, TurningTrial, read_process};
use evolvent_runtime::Clock;

#[test]
fn an_error_in_the_cycle_of_a_job_names_the_job() {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config");
    let text = std::fs::read_to_string(config.join("processes/turn-shaft.toml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("far.toml");
    // Beyond the travel of the machine.
    std::fs::write(&file, text.replace("z_mm = 300.0", "z_mm = 3000.0")).unwrap();
    let route = TurningRoute {
        clock: Clock::Virtual,
        trace: None,
        bus: false,
        bus_prefix: None,
        on_start: &|_| Ok(()),
    };
    let job = read_process(&file).unwrap();
    let outcome = TurningTrial::run(job, &config.join("machines/lathe-2axis.toml"), &route);
    let text = outcome.err().unwrap().to_string();
    assert!(
        text.contains("G0801") && text.contains("the cycle of shaft-60:4:4"),
        "{text}"
    );
    assert!(
        !text.contains("turn.ngc") && !text.contains("evolvent-turn"),
        "{text}"
    );
}
