//! The program turns a capture into observations and a circular test.

use std::process::{Command, Output};

use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter};
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::sample::Sample;
use dbbd_model::measurement::{CircleId, Measurements};
use dbbd_model::robot::Robot;

use crate::cell::codes;
use crate::support::sync_runs::{Run, WORLD, World, plan, run};

/// A capture of the run, as `acquire` writes it.
fn write_capture(path: &std::path::Path, plan: &Plan, run: &Run, finish: bool) {
    let mut writer = CaptureWriter::create(path).unwrap();
    let (plan_csv, plan_json) = plan.to_files().unwrap();
    for (name, content) in [("plan.csv", plan_csv), ("plan.json", plan_json)] {
        let record = CaptureRecord::Attachment { name: name.into(), content: content.into() };
        writer.write(HostNs(0), &record).unwrap();
    }
    let protocol = include_bytes!("../../protocols/dbb-cobs-1.toml").to_vec();
    writer
        .write(HostNs(0), &CaptureRecord::Attachment { name: "protocol.toml".into(), content: protocol })
        .unwrap();
    for (host, sample) in &run.samples {
        writer.write(*host, &CaptureRecord::Samples(vec![*sample])).unwrap();
    }
    if finish {
        writer.finish(HostNs(0), "end mark", 0).unwrap();
    }
}

/// Writes the run as a capture and matches it with the program; returns its output and the observations.
fn through_the_binary(plan: &Plan, run: &Run, finish: bool) -> (Output, Option<Measurements>) {
    let dir = tempfile::tempdir().unwrap();
    let (capture, csv) = (dir.path().join("run"), dir.path().join("obs.csv"));
    write_capture(&capture, plan, run, finish);
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    let output = command.arg("sync").arg(&capture).arg("--out").arg(&csv).output().unwrap();
    let observations = std::fs::read_to_string(&csv).ok();
    (output, observations.map(|text| Measurements::from_csv("obs.csv", &text).unwrap()))
}

#[test]
fn capture_becomes_observations() {
    let plan = plan(10, 12, 12, true);
    let mut run = run(&plan, 10, World { strobe: true, rate_hz: 250.0, ..WORLD });
    let (output, observations) = through_the_binary(&plan, &run, true);
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("12 of 12 poses"), "{said}");
    let observations = observations.unwrap();
    assert_eq!(observations.rows.len(), 12);
    // The job states no noise of the bar, so the default of 2 um (`sigma_um`) is the least.
    assert!(observations.rows.iter().all(|row| row.sigma_mm.unwrap() >= 0.002));
    let kinds: Vec<_> =
        observations.rows.iter().map(|row| row.context.as_ref().unwrap().kind.unwrap()).collect();
    assert_eq!(kinds[..2], [PoseKind::Reference, PoseKind::Measure]);

    let (output, observations) = through_the_binary(&plan, &run, false);
    assert_eq!((output.status.code(), codes(&output)), (Some(3), vec!["W0411".to_owned()]));
    assert_eq!(observations.unwrap().rows.len(), 12);

    let first = Sample { ticks: None, ..run.samples[0].1 };
    run.samples.clear();
    let (output, observations) = through_the_binary(&plan, &run, true);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0407".to_owned()]));
    assert!(observations.is_none());

    // A bar that does not move.
    let still =
        (0..20_000_u32).map(|at| (HostNs(u64::from(at) * 4_000_000), Sample { valid: false, ..first }));
    run.samples = still.collect();
    let (output, observations) = through_the_binary(&plan, &run, true);
    assert_eq!(output.status.code(), Some(1));
    assert!(observations.is_none() && codes(&output).contains(&"E1001".to_owned()), "{:?}", codes(&output));
}

/// A circle in both directions, with stops.
fn circle_plan() -> Plan {
    let job = r#"
        robot = "kr60ha"
        [tool]
ball_mm = [30.0, 20.0, 10.0]
[bar]
        length_mm = 300.0
        stroke_mm = [-5.0, 5.0]
        [[centre]]
        id = 1
        xyz_mm = [1300.0, 0.0, 800.0]
        [[circle]]
        plane = "XY"
        points = 24
        direction = "both"
        orientation = "fixed"
        tilt_deg = 30.0
        start_deg = 10.0
        [motion]
        settle_s = 0.5
        dwell_s = 1.0
    "#;
    let job = Job::from_toml("job.toml", job).unwrap();
    Plan::build(&job, &Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()).unwrap()
}

/// The loss in a run has its code and its share in every command that reads it.
#[test]
fn losses_of_a_run_give_exit_code_3() {
    let plan = circle_plan();
    let whole = run(&plan, 8, World { strobe: true, ..WORLD });
    let dir = tempfile::tempdir().unwrap();
    // Interval of invalid readings, s since the start of the tenth dwell.
    let spoils = [("sound", 0.0..0.0, ""), ("some", 0.8..0.9, "W1007"), ("all", 0.0..2.0, "W1003")];
    for (name, spoiled, code) in spoils {
        let mut run = Run { samples: whole.samples.clone(), readings_mm: Vec::new(), starts_s: Vec::new() };
        for (_, sample) in &mut run.samples {
            let at_s = sample.ticks.unwrap().0 as f64 * 1e-6 - whole.starts_s[9];
            sample.valid = !spoiled.contains(&at_s);
        }
        write_capture(&dir.path().join(name), &plan, &run, true);
        for verb in
            [&["info"][..], &["sync", "--out", "s"], &["identify", "--out", "i"], &["circle", "--out", "c"]]
        {
            let output = crate::cell::dbbd(dir.path(), &[&verb[..1], &[name, "--json"], &verb[1..]].concat());
            let said = codes(&output);
            let about = format!("{name} {}: {:?} {said:?}", verb[0], output.status.code());
            if code.is_empty() {
                let losses = ["W1003", "W1007", "W1415"];
                assert!(!losses.iter().any(|loss| said.iter().any(|code| code == loss)), "{about}");
                continue;
            }
            assert!(output.status.code() == Some(3) && said.iter().any(|one| one == code), "{about}");
            let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            let findings = json["findings"].as_array();
            let finding = findings.unwrap().iter().find(|finding| finding["code"] == code);
            if verb[0] != "identify" {
                let percent = finding.unwrap()["values"]["percent"].as_f64().unwrap();
                assert!(percent > 0.0 && percent < 100.0, "{about}: {percent}");
            }
            assert_eq!(said.contains(&"W1415".to_owned()), name == "all" && verb[0] == "circle", "{about}");
        }
    }
}

#[test]
fn capture_becomes_a_circular_test() {
    let plan = circle_plan();
    let places: Vec<_> = plan
        .rows
        .iter()
        .zip(plan.circle_places())
        .filter(|(row, _)| row.kind == PoseKind::Measure)
        .map(|(row, place)| (row.index, place.unwrap()))
        .collect();
    assert_eq!(places.len(), 48);
    for (at, (_, place)) in places.iter().enumerate() {
        let step = if at < 24 { at } else { 48 - at };
        let angle = (10.0 + 15.0 * step as f64).rem_euclid(360.0);
        // Rounding to a micrometre turns a point on 300 mm by 2e-4 degrees.
        assert!((place.angle_deg - angle).abs() < 2e-4, "{at}: {place:?}");
        assert_eq!((place.clockwise, place.radius_mm), (at >= 24, 300.0));
    }
    let run = run(&plan, 11, World { strobe: true, rate_hz: 250.0, ..WORLD });
    let dir = tempfile::tempdir().unwrap();
    write_capture(&dir.path().join("run"), &plan, &run, true);
    let dbbd = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        let output = command.current_dir(dir.path()).args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    dbbd(&["sync", "run", "--out", "obs.csv"]);
    let observations = std::fs::read_to_string(dir.path().join("obs.csv")).unwrap();
    let observations = Measurements::from_csv("obs.csv", &observations).unwrap();
    for (index, place) in &places {
        let row = observations.rows.iter().find(|row| row.index == *index).unwrap();
        let context = row.context.as_ref().unwrap();
        assert_eq!((context.circle, context.angle_deg), (CircleId::new(1), Some(place.angle_deg)));
    }

    let json: serde_json::Value =
        serde_json::from_slice(&dbbd(&["circle", "run", "--out", "c", "--json"])).unwrap();
    let lengths: Vec<f64> = places
        .iter()
        .map(|(index, _)| observations.rows.iter().find(|row| row.index == *index).unwrap().length_mm)
        .collect();
    // The mean deviation of a full circle, each angle twice, is the mean length less the radius.
    let mean = lengths.iter().sum::<f64>() / 48.0 - 300.0;
    assert!((json["D"].as_f64().unwrap() - mean).abs() < 0.001, "{} {mean}", json["D"]);
    assert_eq!((&json["traces"][0]["points"], &json["traces"][1]["points"]), (&24.into(), &24.into()));
    assert!(json["Gb"].as_f64().unwrap() > 0.1, "the swing of 0.4 mm is there");
    let half = Run { samples: run.samples[..run.samples.len() / 2].to_vec(), ..run };
    write_capture(&dir.path().join("half"), &plan, &half, true);
    let output = crate::cell::dbbd(dir.path(), &["circle", "half", "--out", "h", "--monte-carlo", "0"]);
    assert!(codes(&output).contains(&"E1401".to_owned()), "{:?}", codes(&output));
    let reversals = json["joint_reversals"].as_array().unwrap();
    // On a full circle axis 1 swings out and back once: it reverses at both sides, in either direction.
    let first: Vec<f64> = reversals
        .iter()
        .filter(|mark| mark["joint"] == 1)
        .map(|mark| mark["angle_deg"].as_f64().unwrap())
        .collect();
    assert_eq!(first.len(), 4, "{first:?}");
    assert!(
        first.iter().all(|angle| (60.0..130.0).contains(angle) || (230.0..300.0).contains(angle)),
        "{first:?}"
    );
}
