//! A stream of lengths and a plan become observations by stillness, strobe or reports, with wrapped and restarted
//! clocks.

use dbbd_job::plan::PoseKind;
use dbbd_job::recording::matching::MatchingFinding;
use dbbd_job::recording::matching::{DwellSource, MatchOutcome, MatchingInput, PoseMatching, match_poses};
use dbbd_job::recording::{DwellReport, reported_axes};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::sample::Sample;

use crate::test_support::sync_runs::{DWELL_S, Run, SETTLE_S, WORLD, World, plan, right, run, stream};

fn codes(matching: &PoseMatching) -> Vec<&'static str> {
    matching.findings.iter().map(|finding| finding.code().as_str()).collect()
}

/// Findings about a disturbed run, by code.
type Spoil = fn(&mut Run);
const SPOILED: [(&str, bool, Spoil); 9] = [
    ("W1002", false, |run| {
        run.samples.drain(..run.samples.len() / 5);
    }),
    ("W1003", true, |run| run.samples.truncate(run.samples.len() / 3)),
    ("W1004", true, |run| lower(run, 12)),
    ("I1012", false, |run| {
        let half = run.samples.len() / 2;
        let from = run.samples[half].1.ticks.unwrap().0;
        for (_, sample) in &mut run.samples[half..] {
            sample.ticks = sample.ticks.map(|ticks| DeviceTicks(ticks.0 - from));
        }
    }),
    ("I1011", true, |run| {
        let from_s = run.starts_s[9] + SETTLE_S + 0.3;
        run.samples.retain(|(_, sample)| !(from_s..from_s + 0.2).contains(&seconds(sample)));
    }),
    ("W1005", true, |run| {
        run.samples.iter_mut().for_each(|(_, sample)| sample.reading_mm += 1e-3 * seconds(sample));
    }),
    ("I1020", true, |run| run.samples.truncate(run.samples.len() / 3)),
    ("I1021", true, |run| lower(run, 12)),
    ("I1022", true, |run| run.samples.iter_mut().for_each(|(_, sample)| sample.valid = false)),
];

fn seconds(sample: &Sample) -> f64 {
    sample.ticks.unwrap().0 as f64 * 1e-6
}

/// Removes the strobe of a dwell.
fn lower(run: &mut Run, dwell: usize) {
    let lost = run.starts_s[dwell];
    for (_, sample) in &mut run.samples {
        if (lost..lost + 2.0).contains(&seconds(sample)) {
            sample.trigger = Some(false);
        }
    }
}

#[test]
fn findings_of_a_run_have_codes() {
    for (code, strobe, spoil) in SPOILED {
        let plan = plan(4, 61, 61, code != "W1002");
        let mut run = run(&plan, 4, World { strobe, repeatability_mm: 0.0, ..WORLD });
        spoil(&mut run);
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        let reasons = matching.outcomes.iter().filter_map(|pose| match &pose.outcome {
            MatchOutcome::Matched { .. } => None,
            MatchOutcome::Missing { reason } | MatchOutcome::Ambiguous { reason } => {
                Some(reason.code().as_str())
            }
        });
        let all: Vec<&str> = codes(&matching).into_iter().chain(reasons).collect();
        assert!(all.contains(&code), "{code}: {:?}", matching.findings);
        if code == "W1002" {
            assert!(all.contains(&"I1023"), "{all:?}");
        }
    }
    // Axis angles that are slightly off the commanded ones everywhere, and one that is far off.
    let plan = plan(8, 30, 30, true);
    let run = run(&plan, 8, World { strobe: true, ..WORLD });
    let stream = stream(&run.samples);
    for (off_deg, code) in [(0.3, "I1010"), (10.0, "W1006")] {
        let axes = plan.rows.iter().map(|row| (row.index, row.axes_deg.map(|deg| deg + off_deg))).collect();
        let matching =
            match_poses(&MatchingInput { axes_deg: Some(&axes), ..MatchingInput::new(&plan, &stream) });
        assert_eq!(codes(&matching), [code]);
    }
}

/// Unusable reports are reported, and the strobe replaces them.
#[test]
fn unusable_reports_have_a_code() {
    let plan = plan(5, 30, 30, true);
    let mut run = run(&plan, 5, World { strobe: true, ..WORLD });
    let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
    let reports: Vec<DwellReport> = dwells
        .zip(&run.starts_s)
        .flat_map(|(row, start_s)| {
            [(1, SETTLE_S), (2, SETTLE_S + DWELL_S)].map(|(phase, after_s)| DwellReport {
                host: HostNs(((start_s + after_s) * 1e9) as u64),
                index: row.index,
                phase,
                axes_deg: row.axes_deg,
            })
        })
        .collect();
    let matched = |run: &Run, reports: &[DwellReport]| {
        let stream = stream(&run.samples);
        match_poses(&MatchingInput { reports, ..MatchingInput::new(&plan, &stream) })
    };
    let whole = matched(&run, &reports);
    assert_eq!((whole.source, codes(&whole)), (DwellSource::Reports, vec![]));
    let begins: Vec<DwellReport> = reports.iter().filter(|report| report.phase == 1).copied().collect();
    let unpaired = matched(&run, &begins);
    // A simulation ten times faster than real time: host stamps say nothing about the bar's clock.
    run.samples.iter_mut().for_each(|(host, _)| host.0 /= 10);
    let fast: Vec<DwellReport> =
        reports.iter().map(|report| DwellReport { host: HostNs(report.host.0 / 10), ..*report }).collect();
    for matching in [unpaired, matched(&run, &fast)] {
        assert_eq!((matching.source, codes(&matching)), (DwellSource::Strobe, vec!["W1080"]));
        assert_eq!(right(&plan, &run, &matching), 30);
    }
}

#[test]
fn run_without_strobe_is_matched_by_intervals() {
    let mut all = 0;
    for seed in 0..4 {
        let plan = plan(seed, 60, 30, true);
        let override_factor = [1.0, 0.5, 0.7, 0.9][seed as usize];
        let run = run(&plan, seed, World { override_factor, ..WORLD });
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        assert_eq!(matching.source, DwellSource::Stillness);
        let found = right(&plan, &run, &matching);
        eprintln!(
            "seed {seed}: {found} of 60, override {:?}, {} spurious",
            matching.override_factor,
            matching.spurious.len()
        );
        for pose in matching.outcomes.iter().filter(|pose| pose.reading().is_none()) {
            eprintln!("{pose:?}");
        }
        assert!((matching.override_factor.unwrap() / override_factor - 1.0).abs() < 0.02);
        all += found;
    }
    assert!(all >= 228, "{all} of 240 poses have a length");
}

/// Long moves determine the override so well that a step of the search grid is many standard deviations.
#[test]
fn override_is_estimated_if_moves_are_long() {
    let mut plan = plan(6, 30, 30, true);
    plan.header.moves.iter_mut().for_each(|time| time.duration_s *= 4.0);
    for percent in [29_u32, 41, 50, 55, 73, 97] {
        let override_factor = f64::from(percent) / 100.0;
        let world = World { override_factor, strobe: true, rate_hz: 100.0, ..WORLD };
        let run = run(&plan, u64::from(percent), world);
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        assert_eq!(right(&plan, &run, &matching), 30, "{percent} %: {:?}", matching.override_factor);
        assert!((matching.override_factor.unwrap() / override_factor - 1.0).abs() < 0.002, "{percent} %");
    }
}

#[test]
fn noisy_bar_loses_poses_without_wrong_pairs() {
    for (seed, correlation, noise_mm, rate_hz) in [(0, 0.8, 0.002, 1000.0), (1, 0.0, 0.005, 250.0)] {
        let plan = plan(20 + seed, 60, 60, true);
        let run = run(&plan, seed, World { correlation, noise_mm, rate_hz, ..WORLD });
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &matching);
        eprintln!("noise {noise_mm} r {correlation} at {rate_hz} Hz: {found} of 60 joined");
        assert!(found >= 24, "{found} of 60");
    }
}

#[test]
fn strobes_pair_poses_with_equal_moves() {
    let plan = plan(3, 50, 25, false);
    let world = World { strobe: true, ..WORLD };
    let run = run(&plan, 3, world);
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    assert_eq!(matching.source, DwellSource::Strobe);
    assert_eq!(right(&plan, &run, &matching), 50);
}

#[test]
fn lost_strobe_shifts_no_pose() {
    let plan = plan(4, 50, 25, true);
    let mut run = run(&plan, 4, World { strobe: true, ..WORLD });
    let lost = run.starts_s[12];
    for (_, sample) in &mut run.samples {
        let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
        if (lost..lost + 2.0).contains(&t_s) {
            sample.trigger = Some(false);
        }
    }
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    let found = right(&plan, &run, &matching);
    assert_eq!(found, 49);
    let count = MatchingFinding::StrobeCount { module: 1, strobes: 24, dwells: 25 };
    assert_eq!(matching.findings[0], count);
    assert_eq!(count.code().as_str(), "W1004");
    assert!(
        matches!(
            matching.outcomes[12].outcome,
            MatchOutcome::Missing { reason: MatchingFinding::NoneWhenDue { dwell: "strobe", .. } }
        ),
        "{:?}",
        matching.outcomes[12]
    );
}

#[test]
fn bouncing_and_doubled_strobes_lose_no_other_pose() {
    for (bounce, extra) in [(true, false), (false, true)] {
        let plan = plan(4, 50, 25, true);
        let mut run = run(&plan, 4, World { strobe: true, ..WORLD });
        let (bounced_s, before_s) = (run.starts_s[30] + SETTLE_S + 0.2, run.starts_s[7] - 0.6);
        for (_, sample) in &mut run.samples {
            let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
            if bounce && (bounced_s..bounced_s + 0.05).contains(&t_s) {
                sample.trigger = Some(false);
            }
            // A strobe while the robot moves, which is not commanded.
            if extra && (before_s..before_s + 0.4).contains(&t_s) {
                sample.trigger = Some(true);
            }
        }
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &matching);
        eprintln!("bounce {bounce}, extra {extra}: {found} of 50");
        let count = MatchingFinding::StrobeCount { module: 1, strobes: 26, dwells: 25 };
        if bounce {
            assert_eq!((found, matching.findings.as_slice()), (50, &[][..]));
        } else {
            assert!(found >= 48, "{found}");
            assert_eq!(matching.findings[0], count);
        }
    }
}

#[test]
fn wrapped_counter_changes_nothing() {
    let plan = plan(5, 20, 20, true);
    let plain = run(&plan, 5, WORLD);
    let wrapped = run(&plan, 5, World { ticks_begin: (1 << 32) - 30_000_000, ..WORLD });
    let csv =
        |run: &Run| match_poses(&MatchingInput::new(&plan, &stream(&run.samples))).observations.to_csv();
    assert!(stream(&wrapped.samples).breaks.is_empty());
    // The unwrapped times differ by rounding alone.
    assert_eq!(csv(&plain), csv(&wrapped));
}

#[test]
fn restarted_counter_loses_at_most_one_dwell() {
    let plan = plan(6, 40, 40, true);
    let mut run = run(&plan, 6, WORLD);
    let at_s = run.starts_s[20] + 0.9;
    for (_, sample) in &mut run.samples {
        let ticks = sample.ticks.unwrap().0;
        sample.ticks = Some(DeviceTicks(ticks.checked_sub((at_s * 1e6) as u64).unwrap_or(ticks)));
    }
    let stream = stream(&run.samples);
    assert_eq!(stream.breaks.len(), 1);
    let matching = match_poses(&MatchingInput::new(&plan, &stream));
    let found = right(&plan, &run, &matching);
    assert!(found >= 36, "{found} of 40");
    assert!(codes(&matching).contains(&"I1012"), "{:?}", matching.findings);
}

#[test]
fn reports_identify_the_poses() {
    let plan = plan(8, 30, 30, false);
    let run = run(&plan, 8, WORLD);
    let rows = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
    let reports: Vec<DwellReport> = rows
        .zip(&run.starts_s)
        .flat_map(|(row, start_s)| {
            let host = |s: f64| HostNs(((start_s + s) * 1e9) as u64 + 8_000_000);
            let report =
                |phase, s| DwellReport { host: host(s), index: row.index, phase, axes_deg: row.axes_deg };
            [report(1, SETTLE_S), report(2, SETTLE_S + DWELL_S)]
        })
        .collect();
    let stream = stream(&run.samples);
    let matching = match_poses(&MatchingInput { reports: &reports, ..MatchingInput::new(&plan, &stream) });
    assert_eq!(matching.source, DwellSource::Reports);
    assert_eq!(right(&plan, &run, &matching), 30);
    assert_eq!(matching.findings, []);

    // The measured angles are used: the mean of start and end. Angles of another pose give a warning.
    let mut elsewhere = reports.clone();
    elsewhere[8].axes_deg[2] += 0.02;
    elsewhere[20].axes_deg[5] += 0.4;
    let axes = reported_axes(&elsewhere);
    let matching = match_poses(&MatchingInput {
        reports: &elsewhere,
        axes_deg: Some(&axes),
        ..MatchingInput::new(&plan, &stream)
    });
    let row = &matching.observations.rows[4];
    assert!((row.axes.degrees()[2] - plan.rows[row.index as usize - 1].axes_deg[2] - 0.01).abs() < 1e-12);
    let [MatchingFinding::AxesMoved { poses: 1, worst_deg }] = matching.findings[..] else {
        panic!("{:?}", matching.findings)
    };
    assert!((worst_deg - 0.2).abs() < 1e-9, "{worst_deg}");
}

/// The samples from the start of a dwell on, less two seconds.
fn from_dwell(run: &Run, dwell: usize) -> Vec<(HostNs, Sample)> {
    let from_s = run.starts_s[dwell] - 2.0;
    let is_later = |sample: &Sample| sample.ticks.unwrap().0 as f64 * 1e-6 >= from_s;
    run.samples.iter().filter(|(_, sample)| is_later(sample)).copied().collect()
}

/// The operator began at the third of four modules.
#[test]
fn run_may_begin_at_a_later_module() {
    let plan = plan(4, 48, 12, true);
    let run = run(&plan, 4, World { strobe: true, ..WORLD });
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&from_dwell(&run, 24))));
    assert_eq!(matching.observations.rows.len(), 24);
    let some = MatchingFinding::SomeModules { first: 3, last: 4, modules: 4 };
    assert_eq!(matching.findings[0], some);
    assert!(!codes(&matching).contains(&"W1004"), "{:?}", matching.findings);
}

/// Four dwells at the end of a run do not show its plan; one of an earlier version never does.
#[test]
fn few_dwells_or_an_old_plan_do_not_show_the_plan() {
    let mut plan = plan(5, 20, 20, true);
    let run = run(&plan, 5, World { strobe: true, ..WORLD });
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&from_dwell(&run, 16))));
    assert!(codes(&matching).contains(&"W1085"), "{:?}", matching.findings);
    assert_eq!(matching.code.foreign_module(), None);
    plan.header.pose_hash.clear();
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    assert_eq!(codes(&matching), ["W1086"]);
}
