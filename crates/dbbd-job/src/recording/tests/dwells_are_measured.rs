//! Dwells: value and uncertainty, creep, drift, and missing samples.

use dbbd_job::plan::PoseKind;
use dbbd_job::recording::matching::MatchingFinding;
use dbbd_job::recording::matching::{MatchOutcome, MatchingInput, match_poses, still_dwells};
use dbbd_job::recording::reading_between;
use dbbd_model::diagnostic::Finding;
use dbbd_model::robot::AXES;

use crate::test_support::sync_runs::{BAR_MM, DWELL_S, SETTLE_S, WORLD, World, plan, right, run, stream};

#[test]
fn still_dwells_carry_value_and_uncertainty() {
    let plan = plan(1, 40, 40, true);
    // More noise hides the faintest moves: two dwells then look like one.
    let cases = [(0.0, 0.002, 1000.0, 37), (0.8, 0.002, 1000.0, 28), (0.0, 0.005, 250.0, 22)];
    for (correlation, noise_mm, rate_hz, least) in cases {
        let run = run(&plan, 7, World { correlation, noise_mm, rate_hz, ..WORLD });
        let stream = stream(&run.samples);
        let dwells = still_dwells(&stream, 0.8);
        let mut normalised = Vec::new();
        for (start_s, reading_mm) in run.starts_s.iter().zip(&run.readings_mm) {
            let Some(dwell) = dwells.iter().find(|dwell| (dwell.start_s - start_s).abs() < 0.3) else {
                continue;
            };
            let reading =
                reading_between(&stream, dwell.start_s + 0.5, (dwell.end_s - 0.15).min(dwell.start_s + 1.5))
                    .unwrap();
            // Of AR(1) noise, the mean's variance is that of N (1 - r) / (1 + r) samples.
            let effective = reading.samples as f64 * (1.0 - correlation) / (1.0 + correlation);
            let u_mm = noise_mm / effective.sqrt();
            assert!((0.6..1.7).contains(&(reading.u_mm / u_mm)), "{} is not {u_mm}", reading.u_mm);
            normalised.push((reading.reading_mm - reading_mm) / reading.u_mm);
        }
        let rms = (normalised.iter().map(|z| z * z).sum::<f64>() / normalised.len() as f64).sqrt();
        eprintln!("noise {noise_mm} r {correlation}: {} of 40 found, rms {rms:.2} u", normalised.len());
        assert!(normalised.len() >= least, "{} of 40 dwells found", normalised.len());
        assert!((0.6..1.5).contains(&rms), "errors are {rms} standard uncertainties");
    }
}

/// A reading that stays on a step of a coarse scale, or hardly leaves it, is known to that step: its standard
/// uncertainty is
/// the step over the root of 12 (GUM 4.3.7), not the small scatter over the root of the count.
#[test]
fn coarse_scale_limits_the_uncertainty() {
    const STEP_MM: f64 = 0.01;
    let plan = plan(14, 30, 30, true);
    let mut run = run(&plan, 14, World { strobe: true, ..WORLD });
    for (_, sample) in &mut run.samples {
        sample.reading_mm = (sample.reading_mm / STEP_MM).round() * STEP_MM;
    }
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    let step = STEP_MM / 12f64.sqrt();
    let (mut on_the_step, mut least) = (0, f64::INFINITY);
    for pose in &matching.outcomes {
        let Some(dwell) = pose.reading() else { panic!("{pose:?}") };
        assert!(dwell.u_mm < 1.001 * step, "{dwell:?}");
        on_the_step += usize::from((dwell.u_mm / step - 1.0).abs() < 1e-3);
        least = least.min(dwell.u_mm);
    }
    // If it flickers between two steps, the scatter averages out.
    eprintln!("{on_the_step} of {} on the step, {least} mm at least", matching.outcomes.len());
    assert!(on_the_step > 0);
}

#[test]
fn invalid_readings_are_excluded_and_drift_is_detected() {
    let plan = plan(9, 61, 61, true);
    let mut run = run(&plan, 9, World { repeatability_mm: 0.0, strobe: true, ..WORLD });
    let (from_s, dead_s) = (run.starts_s[30], run.starts_s[33]);
    let end_s = run.samples.len() as f64 / WORLD.rate_hz;
    for (at, (_, sample)) in run.samples.iter_mut().enumerate() {
        let t_s = at as f64 / WORLD.rate_hz;
        let half = (from_s + 0.5..from_s + 1.0).contains(&t_s);
        if half || (dead_s..dead_s + 1.6).contains(&t_s) {
            sample.valid = false;
            sample.reading_mm = 99.0;
        } else {
            sample.reading_mm += 0.03 * t_s / end_s;
        }
    }
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    assert_eq!(matching.observations.rows.len(), 60);
    assert!(matching.observations.rows.iter().all(|row| (row.length_mm - BAR_MM).abs() < 2.0));
    assert!(matches!(
        matching.outcomes[33].outcome,
        MatchOutcome::Missing { reason: MatchingFinding::NotValid { .. } }
    ));
    let drift = matching.drift.unwrap();
    assert_eq!(drift.readings, 4);
    // 30 um over the whole run, of which the reference readings span nearly all.
    assert!(drift.significant && (drift.change_mm - 0.028).abs() < 0.003, "{drift:?}");
}

/// Two readings of a pose have no standard deviation: the largest change of all such poses counts, not the last.
#[test]
fn largest_drift_is_reported() {
    let mut plan = plan(9, 80, 40, true);
    let second = plan.rows.iter_mut().filter(|row| row.circle == 2 && row.kind == PoseKind::Reference);
    second.for_each(|row| row.axes_deg = [2.0; AXES]);
    let mut run = run(&plan, 9, World { repeatability_mm: 0.0, strobe: true, ..WORLD });
    let moved_s = run.starts_s[20];
    for (at, (_, sample)) in run.samples.iter_mut().enumerate() {
        let t_s = at as f64 / WORLD.rate_hz;
        if (moved_s..moved_s + SETTLE_S + DWELL_S).contains(&t_s) {
            sample.reading_mm += 0.05;
        }
    }
    let drift = match_poses(&MatchingInput::new(&plan, &stream(&run.samples))).drift.unwrap();
    assert_eq!((drift.readings, drift.sd_mm, drift.significant), (2, None, false));
    assert!((drift.change_mm - 0.05).abs() < 0.003, "{drift:?}");
}

#[test]
fn creep_is_flagged_in_its_dwell_only() {
    let plan = plan(12, 30, 30, true);
    let mut run = run(&plan, 12, World { strobe: true, ..WORLD });
    let creeping = [4, 11, 25];
    for (_, sample) in &mut run.samples {
        let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
        for pose in creeping {
            let since_s = t_s - run.starts_s[pose] - SETTLE_S;
            if (0.0..DWELL_S).contains(&since_s) {
                sample.reading_mm += 0.003 * since_s;
            }
        }
    }
    let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
    for (pose, outcome) in matching.outcomes.iter().enumerate() {
        let Some(dwell) = outcome.reading() else { panic!("{outcome:?}") };
        assert_eq!(dwell.creep_mm.is_some(), creeping.contains(&pose), "pose {pose}: {dwell:?}");
        if let Some(creep_mm) = dwell.creep_mm {
            // 3 um in the second; 500 samples of 2 um of noise give it to 0.3 um.
            assert!((creep_mm - 0.003).abs() < 0.0012, "{creep_mm}");
        }
    }
    assert!(matching.findings.contains(&MatchingFinding::Creep { dwells: 3 }));
    assert_eq!(matching.findings[0].code().as_str(), "I1011");
}

#[test]
fn outage_within_a_dwell_rejects_it_only_if_little_is_left() {
    for strobe in [true, false] {
        let plan = plan(13, 40, 40, true);
        let mut run = run(&plan, 13, World { strobe, repeatability_mm: 0.05, ..WORLD });
        let begins = [run.starts_s[9] + SETTLE_S + 0.3, run.starts_s[22] + SETTLE_S + 0.05];
        let ends = [begins[0] + 0.3, begins[1] + 0.9];
        run.samples.retain(|(_, sample)| {
            let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
            !(0..2).any(|outage| (begins[outage]..ends[outage]).contains(&t_s))
        });
        let matching = match_poses(&MatchingInput::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &matching);
        eprintln!("strobe {strobe}: {found} of 40, {:?} {:?}", matching.outcomes[9], matching.outcomes[22]);
        assert!(found >= if strobe { 39 } else { 36 }, "{found}");
        if let Some(dwell) = matching.outcomes[9].reading() {
            let read_s = dwell.samples as f64 / 500.0;
            let whole = dwell.gaps == 1 && (0.5..0.8).contains(&read_s);
            // By stillness alone only the part before the outage may be detected.
            let part = !strobe && dwell.gaps == 0 && (0.3..0.5).contains(&read_s);
            assert!(whole || part, "{dwell:?}");
        } else {
            assert!(!strobe, "{:?}", matching.outcomes[9]);
        }
        assert!(matching.outcomes[22].reading().is_none(), "{:?}", matching.outcomes[22]);
    }
}
