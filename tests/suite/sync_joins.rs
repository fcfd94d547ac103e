//! A stream of lengths and a plan become observations: through stillness, strobe or reports, over
//! wrapped and restarted clocks.

use dbbd::plan::Kind;
use dbbd::sync::{Fate, Input, Report, Source, observations, reported_axes};
use dbbd::units::{DeviceTicks, HostNs};

use crate::sync_runs::{DWELL_S, Run, SETTLE_S, WORLD, World, plan, right, run, stream};

#[test]
fn a_run_without_strobe_is_joined_by_its_intervals() {
    let mut all = 0;
    for seed in 0..4 {
        let plan = plan(seed, 60, 30, true);
        let override_factor = [1.0, 0.5, 0.7, 0.9][seed as usize];
        let run = run(&plan, seed, World { override_factor, ..WORLD });
        let synced = observations(&Input::new(&plan, &stream(&run.samples)));
        assert_eq!(synced.source, Source::Stillness);
        let found = right(&plan, &run, &synced);
        eprintln!(
            "seed {seed}: {found} of 60, override {:?}, {} spurious",
            synced.override_factor,
            synced.spurious.len()
        );
        for pose in synced.fates.iter().filter(|pose| !matches!(pose.fate, Fate::Matched { .. })) {
            eprintln!("{pose:?}");
        }
        assert!((synced.override_factor.unwrap() / override_factor - 1.0).abs() < 0.02);
        all += found;
    }
    assert!(all >= 228, "{all} of 240 poses have a length");
}

#[test]
fn a_noisy_bar_loses_poses_but_pairs_none_wrongly() {
    for (seed, correlation, noise_mm, rate_hz) in [(0, 0.8, 0.002, 1000.0), (1, 0.0, 0.005, 250.0)] {
        let plan = plan(20 + seed, 60, 60, true);
        let run = run(&plan, seed, World { correlation, noise_mm, rate_hz, ..WORLD });
        let synced = observations(&Input::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &synced);
        eprintln!("noise {noise_mm} r {correlation} at {rate_hz} Hz: {found} of 60 joined");
        assert!(found >= 24, "{found} of 60");
    }
}

#[test]
fn strobes_count_even_where_all_moves_are_equal() {
    let plan = plan(3, 50, 25, false);
    let world = World { strobe: true, ..WORLD };
    let run = run(&plan, 3, world);
    let synced = observations(&Input::new(&plan, &stream(&run.samples)));
    assert_eq!(synced.source, Source::Strobe);
    assert_eq!(right(&plan, &run, &synced), 50);
}

#[test]
fn a_lost_strobe_shifts_no_pose() {
    let plan = plan(4, 50, 25, true);
    let mut run = run(&plan, 4, World { strobe: true, ..WORLD });
    let lost = run.starts_s[12];
    for (_, sample) in &mut run.samples {
        let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
        if (lost..lost + 2.0).contains(&t_s) {
            sample.trigger = Some(false);
        }
    }
    let synced = observations(&Input::new(&plan, &stream(&run.samples)));
    let found = right(&plan, &run, &synced);
    assert_eq!(found, 49);
    let named = synced.warnings.iter().find(|warning| warning.text.contains("strobes")).unwrap();
    assert_eq!(named.text, "module 1: 24 strobes were seen where 25 dwells are commanded");
    assert!(
        matches!(&synced.fates[12].fate, Fate::Missing { reason } if reason.contains("no strobe")),
        "{:?}",
        synced.fates[12]
    );
}

#[test]
fn a_strobe_that_bounces_or_comes_twice_costs_nothing_else() {
    for (bounce, extra) in [(true, false), (false, true)] {
        let plan = plan(4, 50, 25, true);
        let mut run = run(&plan, 4, World { strobe: true, ..WORLD });
        let (bounced_s, before_s) = (run.starts_s[30] + SETTLE_S + 0.2, run.starts_s[7] - 0.6);
        for (_, sample) in &mut run.samples {
            let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
            if bounce && (bounced_s..bounced_s + 0.05).contains(&t_s) {
                sample.trigger = Some(false);
            }
            // A strobe while the robot moves: nobody commanded it.
            if extra && (before_s..before_s + 0.4).contains(&t_s) {
                sample.trigger = Some(true);
            }
        }
        let synced = observations(&Input::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &synced);
        eprintln!("bounce {bounce}, extra {extra}: {found} of 50");
        let named = synced.warnings.iter().find(|warning| warning.text.contains("strobes"));
        if bounce {
            assert_eq!((found, named), (50, None));
        } else {
            assert!(found >= 48, "{found}");
            assert_eq!(named.unwrap().text, "module 1: 26 strobes were seen where 25 dwells are commanded");
        }
    }
}

#[test]
fn a_wrapped_counter_changes_nothing() {
    let plan = plan(5, 20, 20, true);
    let plain = run(&plan, 5, WORLD);
    let wrapped = run(&plan, 5, World { ticks_begin: (1 << 32) - 30_000_000, ..WORLD });
    let csv = |run: &Run| observations(&Input::new(&plan, &stream(&run.samples))).observations.to_csv();
    assert!(stream(&wrapped.samples).breaks.is_empty());
    // The unwrapped times differ by rounding alone.
    assert_eq!(csv(&plain), csv(&wrapped));
}

#[test]
fn a_restarted_counter_costs_at_most_the_dwell_it_falls_into() {
    let plan = plan(6, 40, 40, true);
    let mut run = run(&plan, 6, WORLD);
    let at_s = run.starts_s[20] + 0.9;
    for (_, sample) in &mut run.samples {
        let ticks = sample.ticks.unwrap().0;
        sample.ticks = Some(DeviceTicks(ticks.checked_sub((at_s * 1e6) as u64).unwrap_or(ticks)));
    }
    let stream = stream(&run.samples);
    assert_eq!(stream.breaks.len(), 1);
    let synced = observations(&Input::new(&plan, &stream));
    let found = right(&plan, &run, &synced);
    assert!(found >= 36, "{found} of 40");
    assert!(synced.warnings.iter().any(|warning| warning.text.contains("clock")));
}

#[test]
fn the_controllers_reports_name_the_poses() {
    let plan = plan(8, 30, 30, false);
    let run = run(&plan, 8, WORLD);
    let rows = plan.rows.iter().filter(|row| row.kind != Kind::Transit);
    let reports: Vec<Report> = rows
        .zip(&run.starts_s)
        .flat_map(|(row, start_s)| {
            let host = |s: f64| HostNs(((start_s + s) * 1e9) as u64 + 8_000_000);
            let report = |phase, s| Report { host: host(s), index: row.index, phase, axes_deg: row.axes_deg };
            [report(1, SETTLE_S), report(2, SETTLE_S + DWELL_S)]
        })
        .collect();
    let stream = stream(&run.samples);
    let synced = observations(&Input { reports: &reports, ..Input::new(&plan, &stream) });
    assert_eq!(synced.source, Source::Reports);
    assert_eq!(right(&plan, &run, &synced), 30);
    assert_eq!(synced.warnings, []);

    // The measured angles are used: the mean of begin and end. Angles of elsewhere are a doubt.
    let mut elsewhere = reports.clone();
    elsewhere[8].axes_deg[2] += 0.02;
    elsewhere[20].axes_deg[5] += 0.4;
    let axes = reported_axes(&elsewhere);
    let synced =
        observations(&Input { reports: &elsewhere, axes_deg: Some(&axes), ..Input::new(&plan, &stream) });
    let row = &synced.observations.rows[4];
    assert!((row.axes_deg[2] - plan.rows[row.index as usize - 1].axes_deg[2] - 0.01).abs() < 1e-12);
    let said = &synced.warnings[0];
    assert!(
        said.doubt && said.text.starts_with("at 1 poses") && said.text.contains("0.20 degrees"),
        "{said:?}"
    );
}
