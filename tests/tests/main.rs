//! Tests across crates and with foreign clients, in one executable.

mod bad_input;
mod bridges;
mod checks;
mod clock_lock;
mod command_floods;
mod command_line;
mod corrections;
mod documents;
mod drive_faults;
mod exact_path;
mod exit_codes_of_bridges;
mod foreign_clients;
mod full_disks;
mod handwheel;
mod holds_in_programs;
mod homing;
mod imports;
mod index_on_bridges;
mod killed_runs;
mod killed_service;
mod killed_simulators;
mod late_for_nobody;
mod leaving;
mod leaving_random;
mod linuxcnc_tools;
mod long_programs;
mod machines_by_name;
mod network_commands;
mod number_names;
mod operate_by_ctl;
mod operate_commands;
mod operate_jogs;
mod operate_programs;
mod operate_service;
mod operator_messages;
mod power_cycles;
mod probing;
mod random_faults;
mod random_thread_faults;
mod real_programs;
mod run_status;
mod same_bits;
mod screen_server;
mod served_drives;
mod served_recording;
mod served_signals;
mod served_spindles;
mod served_threads;
mod served_traces;
mod shipped_pairs;
mod shop;
mod signals_in_c;
mod spindle_ramps;
mod spindles;
mod spindles_on_bridges;
mod surface_speed;
mod systemd_units;
mod threads;
mod tool_changer;
mod tool_changes;
mod top;
mod travel_ends;
mod turning;
mod two_spindles;
mod unlimited;
mod unreadable_files;
mod user_codes;

#[test]
fn every_file_of_this_folder_is_a_module() {
    let folder = evolvent_tests::repository().join("tests/tests");
    let own = std::fs::read_to_string(folder.join("main.rs")).unwrap();
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let Some(module) = name.strip_suffix(".rs").filter(|module| *module != "main") else {
            continue;
        };
        assert!(
            own.contains(&format!("\nmod {module};\n")),
            "{name} is not compiled"
        );
    }
}
