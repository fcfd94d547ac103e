//! Codes are stable, explained and provoked.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use dbbd::catalogue;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Finding;

use crate::cell::dbbd;

/// Codes that no test provokes through the binary, and why.
const NOT_HERE: &[(&str, &str)] = &[
    ("E0202", "root may open every port: held beside the code, in device/port/mod.rs"),
    ("E0208", "a system that refuses the list of its devices"),
    ("I0210", "an adapter with a latency timer"),
    ("I0212", "a computer without serial ports"),
    ("I1380", "no input leads to it"),
];

/// The codes that tests provoke, as each module exports them from its tables of cases.
fn provoked() -> Vec<&'static str> {
    [
        crate::acquire_reads_the_bar::provoked(),
        crate::archive::provoked(),
        crate::fleet_is_estimated::provoked(),
        crate::arrays_are_exact::provoked(),
        crate::axes_are_recorded::provoked(),
        crate::axes_show_the_poses::provoked(),
        crate::ball_is_mounted_anew::provoked(),
        crate::zero_changes::provoked(),
        crate::zero_changes::provoked(),
        crate::bars_on_the_network::provoked(),
        crate::bars_that_are_away::provoked(),
        crate::captures_are_joined::provoked(),
        crate::capture_is_taken_away::provoked(),
        crate::capture_survives_damage::provoked(),
        crate::certificate::provoked(),
        crate::changes_are_found::provoked(),
        crate::circular_plays::provoked(),
        crate::circular_quantities::provoked(),
        crate::compensated_robot_arrives::provoked(),
        crate::continuous_circles::provoked(),
        crate::controller_executes_krl::provoked(),
        crate::coupled_axes::provoked(),
        crate::doubted_inputs::provoked(),
        crate::doubts_go_along::provoked(),
        crate::ekrl_reports_the_dwells::provoked(),
        crate::definitions_are_checked::provoked(),
        crate::every_device_round_trips::provoked(),
        crate::files_of_two_runs::provoked(),
        crate::first_contact::provoked(),
        crate::imports_foreign_traces::provoked(),
        crate::infeasible_jobs_are_refused::provoked(),
        crate::identity_travels::provoked(),
        crate::inverse_kinematics::provoked(),
        crate::job_keys::provoked(),
        crate::krl_reads_back::provoked(),
        crate::says_what_it_found::provoked(),
        crate::logged_axes_identify::provoked(),
        crate::mistakes_are_named::provoked(),
        crate::mounting_faults::provoked(),
        crate::no_stage_is_a_dead_end::provoked(),
        crate::nothing_wrong_is_silent::provoked(),
        crate::plan_is_refused_with_a_reason::provoked(),
        crate::plans_read_back::provoked(),
        crate::positions_identify::provoked(),
        crate::programs_of_other_makes::provoked(),
        crate::provenance::provoked(),
        crate::rapid_and_urscript::provoked(),
        crate::refuses_bad_input::provoked(),
        crate::reversal_steps_hold::provoked(),
        crate::report_is_self_contained::provoked(),
        crate::results_are_compared::provoked(),
        crate::rows_are_used_once::provoked(),
        crate::second_run_continues::provoked(),
        crate::simulator_refuses::provoked(),
        crate::service_answers_as_documented::provoked(),
        crate::service_holds_out::provoked(),
        crate::service_refuses_strangers::provoked(),
        crate::service_runs::provoked(),
        crate::sync_joins::provoked(),
        crate::uncertainties_hold::provoked(),
        crate::units_and_mixed_files::provoked(),
        crate::users_urdf_is_patched::provoked(),
        crate::what_contradicts_is_named::provoked(),
        crate::sag_and_harmonics_by_evidence::provoked(),
    ]
    .concat()
}

/// The code of an unknown code.
const UNKNOWN: &str = "E0001";
/// The code of a value that a text cannot hold.
const UNWRITTEN: &str = "E0009";

#[test]
fn unserialisable_value_is_an_error() {
    let map = BTreeMap::from([([1, 2], 3)]);
    let texts = [
        serialised::json(&map),
        serialised::json_line(&map),
        serialised::toml(&map),
        serialised::csv_table(["a"], [&[1][..], &[1, 2]]),
    ];
    for text in texts {
        assert_eq!(text.unwrap_err().code().as_str(), UNWRITTEN);
    }
}

#[test]
fn every_code_is_provoked_by_a_test() {
    let provoked =
        [provoked(), NOT_HERE.iter().map(|(code, _)| *code).chain([UNKNOWN, UNWRITTEN]).collect()].concat();
    let silent: Vec<_> = catalogue::entries()
        .map(|entry| entry.code.as_str())
        .filter(|code| !provoked.contains(code))
        .collect();
    assert!(silent.is_empty(), "no test provokes {silent:?}");
}

/// `DBBD_BLESS=1 cargo test troubleshooting_page` writes the page.
#[test]
fn troubleshooting_page_is_the_catalogue() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/troubleshooting.md");
    if std::env::var_os("DBBD_BLESS").is_some() {
        fs::write(&path, catalogue::page()).unwrap();
    }
    assert_eq!(fs::read_to_string(path).unwrap(), catalogue::page(), "DBBD_BLESS=1 writes it anew");
}

#[test]
fn explain_prints_an_entry_and_refuses_an_unknown_code() {
    let root = Path::new(".");
    for entry in catalogue::entries() {
        let output = dbbd(root, &["explain", entry.code.as_str(), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["code"], entry.code.as_str());
    }
    let unknown = dbbd(root, &["explain", "E9999", "--json"]);
    assert_eq!(unknown.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&unknown.stdout).unwrap();
    assert_eq!(json["error"]["code"], UNKNOWN);
}
