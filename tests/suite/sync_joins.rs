//! A stream of lengths and a plan become observations: through stillness, strobe or reports, over
//! wrapped and restarted clocks, with value and uncertainty of every dwell.

use std::process::{Command, Output};

use dbbd::capture::{Record, Writer};
use dbbd::model::{AXES, Observations, Robot};
use dbbd::plan::{Header, Job, Kind, Motion, MoveTime, Plan, PlanRow};
use dbbd::protocol::Sample;
use dbbd::sync::{
    DeviceClock, Fate, Input, Report, Source, Stream, StreamBuilder, Synced, find_still, measure,
    observations, reported_axes,
};
use dbbd::units::{DeviceTicks, HostNs};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

const BAR_MM: f64 = 300.0;
const SETTLE_S: f64 = 0.5;
const DWELL_S: f64 = 1.0;

/// A plan of `poses` dwells in modules of `module` each: three knocks, the dwells, two knocks.
fn plan(seed: u64, poses: u32, module: u32, distinct: bool) -> Plan {
    let mut rng = Pcg64::seed_from_u64(seed);
    let (mut rows, mut moves) = (Vec::new(), Vec::new());
    let mut row = |circle: u32, kind: Kind, duration_s: f64, axes_deg: [f64; AXES]| {
        let index = rows.len() as u32 + 1;
        rows.push(PlanRow {
            index,
            circle,
            centre: 1,
            kind,
            motion: Motion::Lin,
            xyz_mm: [1300.0, 0.0, 800.0],
            abc_deg: [0.0; 3],
            axes_deg,
            status: 2,
            turn: 0,
            length_mm: BAR_MM,
            dwell_s: if kind == Kind::Transit { 0.0 } else { DWELL_S },
        });
        moves.push(MoveTime { index, feed_mm_s: 20.0, turn_deg_s: 20.0, axis_percent: 10.0, duration_s });
    };
    for pose in 0..poses {
        let circle = pose / module + 1;
        let knocks = |count: usize| std::iter::repeat_n(0.3, 2 * count);
        if pose % module == 0 {
            knocks(3).for_each(|s| row(circle, Kind::Transit, s, [0.0; AXES]));
        }
        let kind = if pose % 20 == 0 { Kind::Reference } else { Kind::Measure };
        let axes = if kind == Kind::Reference { [1.0; AXES] } else { [f64::from(pose); AXES] };
        row(circle, kind, if distinct { rng.random_range(0.8..3.0) } else { 1.9 }, axes);
        if pose % module == module - 1 || pose + 1 == poses {
            knocks(2).for_each(|s| row(circle, Kind::Transit, s, [0.0; AXES]));
        }
    }
    let job = serde_json::json!({
        "robot": "kuka-kr60ha",
        "bar": { "length_mm": BAR_MM, "stroke_mm": [-1.0, 1.0] },
        "centre": [{ "id": 1, "xyz_mm": [1300.0, 0.0, 800.0] }],
        "circle": [{ "centre": 1, "plane": "XY", "points": 20 }],
        "motion": { "settle_s": SETTLE_S, "dwell_s": DWELL_S },
    });
    // Read, not built: a header holds more than what matters here.
    let header = serde_json::json!({
        "schema": 1, "hash": "", "job": job, "robot": "", "moves": moves, "checks": [],
    });
    let header: Header = serde_json::from_value(header).unwrap();
    Plan { rows, header }
}

/// How a run is made.
#[derive(Clone, Copy)]
struct World {
    rate_hz: f64,
    noise_mm: f64,
    /// Correlation of neighbouring samples' noise.
    correlation: f64,
    override_factor: f64,
    /// How much the true length swings over the poses, mm.
    swing_mm: f64,
    repeatability_mm: f64,
    strobe: bool,
    ticks_wrap: u64,
    ticks_begin: u64,
}

const WORLD: World = World {
    rate_hz: 500.0,
    noise_mm: 0.002,
    correlation: 0.0,
    override_factor: 0.8,
    swing_mm: 0.4,
    repeatability_mm: 0.02,
    strobe: false,
    ticks_wrap: 1 << 32,
    ticks_begin: 0,
};

const CLOCK: DeviceClock = DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) };

/// Samples with their host stamps, the true reading of each dwell row, and its begin.
struct Run {
    samples: Vec<(HostNs, Sample)>,
    readings_mm: Vec<f64>,
    starts_s: Vec<f64>,
}

/// What the robot does for a while: from, to (mm), how long, and the strobe.
type Phase = (f64, f64, f64, bool);

fn run(plan: &Plan, seed: u64, world: World) -> Run {
    let mut rng = Pcg64::seed_from_u64(seed);
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut phases: Vec<Phase> = Vec::new();
    let (mut readings_mm, mut starts_s) = (Vec::new(), Vec::new());
    let mut at_mm = 0.05;
    let mut knock = false;
    let mut circle = 0;
    let dwells = plan.rows.iter().filter(|row| row.kind != Kind::Transit).count() as f64;
    for (row, time) in plan.rows.iter().zip(&plan.header.moves) {
        if row.circle != circle {
            circle = row.circle;
            phases.push((at_mm, at_mm, 8.0, false)); // HALT
            if world.strobe {
                (0..3).for_each(|_| phases.extend([(at_mm, at_mm, 0.2, true), (at_mm, at_mm, 0.4, false)]));
            }
        }
        let move_s = time.duration_s / world.override_factor;
        if row.kind == Kind::Transit {
            let to_mm = if knock { at_mm - 0.3 } else { at_mm + 0.3 };
            knock = !knock;
            phases.push((at_mm, to_mm, move_s, false));
            at_mm = to_mm;
            continue;
        }
        let turn = readings_mm.len() as f64 / dwells * std::f64::consts::TAU;
        let swing = if row.kind == Kind::Reference {
            0.0
        } else {
            world.swing_mm * (turn.sin() + (2.0 * turn).cos())
        };
        let to_mm = 0.5 * swing + world.repeatability_mm * noise.sample(&mut rng);
        phases.push((at_mm, to_mm, move_s, false));
        starts_s.push(phases.iter().map(|phase| phase.2).sum());
        phases.extend([
            (to_mm, to_mm, SETTLE_S, false),
            (to_mm, to_mm, DWELL_S, world.strobe),
            (to_mm, to_mm, 0.1, false),
        ]);
        readings_mm.push(to_mm);
        at_mm = to_mm;
    }
    phases.push((at_mm, at_mm, 5.0, false));
    let mut samples = Vec::new();
    let (mut phase, mut since_s, mut coloured) = (0, 0.0, 0.0);
    let innovation = (1.0 - world.correlation * world.correlation).sqrt();
    for number in 0.. {
        let t_s = f64::from(number) / world.rate_hz;
        while phase < phases.len() && t_s - since_s >= phases[phase].2 {
            since_s += phases[phase].2;
            phase += 1;
        }
        let Some(&(from, to, lasts_s, strobe)) = phases.get(phase) else { break };
        let share = (t_s - since_s) / lasts_s;
        coloured = world.correlation * coloured + innovation * noise.sample(&mut rng);
        let true_mm = from + (to - from) * travelled(share, lasts_s);
        let ticks = world.ticks_begin + (t_s * 1e6).round() as u64;
        samples.push((
            HostNs((t_s * 1e9) as u64 + rng.random_range(500_000..4_000_000)),
            Sample {
                // 10 nm is the resolution of the frame.
                reading_mm: ((true_mm + world.noise_mm * coloured) * 1e5).round() / 1e5,
                sequence: Some(number as u32 & 0xffff),
                ticks: Some(DeviceTicks(ticks % world.ticks_wrap)),
                trigger: world.strobe.then_some(strobe),
                temperature_c: None,
                valid: true,
                status: 1,
                offset: 0,
            },
        ));
    }
    Run { samples, readings_mm, starts_s }
}

/// Share of the way after a share of the time: a trapezium of speed with ramps of 0.15 s.
fn travelled(share: f64, lasts_s: f64) -> f64 {
    let ramp = (0.15 / lasts_s).min(0.5);
    let speed = 1.0 / (1.0 - ramp);
    let ends = |x: f64| 0.5 * speed * x * x / ramp;
    if share < ramp {
        ends(share)
    } else if share < 1.0 - ramp {
        speed * (share - 0.5 * ramp)
    } else {
        1.0 - ends(1.0 - share)
    }
}

fn stream(samples: &[(HostNs, Sample)]) -> Stream {
    let mut stream = StreamBuilder::new(Some(CLOCK));
    samples.iter().for_each(|(host, sample)| stream.push(*host, sample));
    stream.build()
}

/// Number of the plan's dwells that have a length; every one of them must be the right one.
fn right(plan: &Plan, run: &Run, synced: &Synced) -> usize {
    let dwells: Vec<&PlanRow> = plan.rows.iter().filter(|row| row.kind != Kind::Transit).collect();
    for row in &synced.observations.rows {
        let at = dwells.iter().position(|dwell| dwell.index == row.index).unwrap();
        let off_mm = row.length_mm - BAR_MM - run.readings_mm[at];
        assert!(off_mm.abs() < 5.0 * row.sigma_mm.unwrap() + 2e-4, "row {}: {off_mm} mm off", row.index);
        assert_eq!(row.axes_deg, dwells[at].axes_deg);
    }
    synced.observations.rows.len()
}

#[test]
fn still_stretches_carry_value_and_uncertainty() {
    let plan = plan(1, 40, 40, true);
    // More noise hides the faintest moves: two dwells then look like one.
    let cases = [(0.0, 0.002, 1000.0, 37), (0.8, 0.002, 1000.0, 28), (0.0, 0.005, 250.0, 22)];
    for (correlation, noise_mm, rate_hz, least) in cases {
        let run = run(&plan, 7, World { correlation, noise_mm, rate_hz, ..WORLD });
        let stream = stream(&run.samples);
        let stretches = find_still(&stream, 0.8);
        let mut normalised = Vec::new();
        for (start_s, reading_mm) in run.starts_s.iter().zip(&run.readings_mm) {
            let Some(stretch) = stretches.iter().find(|stretch| (stretch.start_s - start_s).abs() < 0.3)
            else {
                continue;
            };
            let dwell =
                measure(&stream, stretch.start_s + 0.5, (stretch.end_s - 0.15).min(stretch.start_s + 1.5))
                    .unwrap();
            // Of AR(1) noise, the mean's variance is that of N (1 - r) / (1 + r) samples.
            let effective = dwell.samples as f64 * (1.0 - correlation) / (1.0 + correlation);
            let u_mm = noise_mm / effective.sqrt();
            assert!((0.6..1.7).contains(&(dwell.u_mm / u_mm)), "{} is not {u_mm}", dwell.u_mm);
            normalised.push((dwell.reading_mm - reading_mm) / dwell.u_mm);
        }
        let rms = (normalised.iter().map(|z| z * z).sum::<f64>() / normalised.len() as f64).sqrt();
        eprintln!("noise {noise_mm} r {correlation}: {} of 40 found, rms {rms:.2} u", normalised.len());
        assert!(normalised.len() >= least, "{} of 40 dwells found", normalised.len());
        assert!((0.6..1.5).contains(&rms), "errors are {rms} standard uncertainties");
    }
}

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

#[test]
fn invalid_readings_do_not_count_and_drift_is_seen() {
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
    let synced = observations(&Input::new(&plan, &stream(&run.samples)));
    assert_eq!(synced.observations.rows.len(), 60);
    assert!(synced.observations.rows.iter().all(|row| (row.length_mm - BAR_MM).abs() < 2.0));
    assert!(matches!(&synced.fates[33].fate, Fate::Missing { reason } if reason.contains("vouch")));
    let drift = synced.drift.unwrap();
    assert_eq!(drift.readings, 4);
    // 30 um over the whole run, of which the reference readings span nearly all.
    assert!(drift.significant && (drift.change_mm - 0.028).abs() < 0.003, "{drift:?}");
}

#[test]
fn creep_within_a_dwell_is_flagged_where_it_is_and_nowhere_else() {
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
    let synced = observations(&Input::new(&plan, &stream(&run.samples)));
    for (pose, fate) in synced.fates.iter().enumerate() {
        let Fate::Matched { dwell, .. } = &fate.fate else { panic!("{fate:?}") };
        assert_eq!(dwell.creep_mm.is_some(), creeping.contains(&pose), "pose {pose}: {dwell:?}");
        if let Some(creep_mm) = dwell.creep_mm {
            // 3 um in the second; 500 samples of 2 um of noise tell it to 0.3 um.
            assert!((creep_mm - 0.003).abs() < 0.0012, "{creep_mm}");
        }
    }
    assert!(synced.warnings.iter().any(|warning| warning.text.contains("in 3 dwells the reading drifted")));
}

#[test]
fn an_outage_within_a_dwell_costs_it_only_where_little_is_left() {
    for strobe in [true, false] {
        let plan = plan(13, 40, 40, true);
        let mut run = run(&plan, 13, World { strobe, repeatability_mm: 0.05, ..WORLD });
        let begins = [run.starts_s[9] + SETTLE_S + 0.3, run.starts_s[22] + SETTLE_S + 0.05];
        let ends = [begins[0] + 0.3, begins[1] + 0.9];
        run.samples.retain(|(_, sample)| {
            let t_s = sample.ticks.unwrap().0 as f64 * 1e-6;
            !(0..2).any(|outage| (begins[outage]..ends[outage]).contains(&t_s))
        });
        let synced = observations(&Input::new(&plan, &stream(&run.samples)));
        let found = right(&plan, &run, &synced);
        eprintln!("strobe {strobe}: {found} of 40, {:?} {:?}", synced.fates[9], synced.fates[22]);
        assert!(found >= if strobe { 39 } else { 36 }, "{found}");
        if let Fate::Matched { dwell, .. } = &synced.fates[9].fate {
            let read_s = dwell.samples as f64 / 500.0;
            let whole = dwell.gaps == 1 && (0.5..0.8).contains(&read_s);
            // By stillness alone the part before the outage may be all that is seen.
            let part = !strobe && dwell.gaps == 0 && (0.3..0.5).contains(&read_s);
            assert!(whole || part, "{dwell:?}");
        } else {
            assert!(!strobe, "{:?}", synced.fates[9]);
        }
        assert!(!matches!(synced.fates[22].fate, Fate::Matched { .. }), "{:?}", synced.fates[22]);
    }
}

/// A capture of the run, as `acquire` writes it.
fn write_capture(path: &std::path::Path, plan: &Plan, run: &Run, finish: bool) {
    let mut writer = Writer::create(path).unwrap();
    let (plan_csv, plan_json) = plan.to_files();
    for (name, content) in [("plan.csv", plan_csv), ("plan.json", plan_json)] {
        let record = Record::Attachment { name: name.into(), content: content.into() };
        writer.write(HostNs(0), &record).unwrap();
    }
    let protocol = include_bytes!("../../protocols/dbb-cobs-1.toml").to_vec();
    writer.write(HostNs(0), &Record::Attachment { name: "protocol.toml".into(), content: protocol }).unwrap();
    for (host, sample) in &run.samples {
        writer.write(*host, &Record::Samples(vec![sample.into()])).unwrap();
    }
    if finish {
        writer.finish(HostNs(0), "end mark", 0).unwrap();
    }
}

/// Writes the run as a capture and lets the program join it: what it said, and the observations.
fn through_the_binary(plan: &Plan, run: &Run, finish: bool) -> (Output, Option<Observations>) {
    let dir = tempfile::tempdir().unwrap();
    let (capture, csv) = (dir.path().join("run"), dir.path().join("obs.csv"));
    write_capture(&capture, plan, run, finish);
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    let output = command.arg("sync").arg(&capture).arg("--out").arg(&csv).output().unwrap();
    let observations = std::fs::read_to_string(&csv).ok();
    (output, observations.map(|text| Observations::from_csv("obs.csv", &text).unwrap()))
}

#[test]
fn a_capture_becomes_observations() {
    let plan = plan(10, 12, 12, true);
    let mut run = run(&plan, 10, World { strobe: true, rate_hz: 250.0, ..WORLD });
    let (output, observations) = through_the_binary(&plan, &run, true);
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("12 of 12 poses"), "{said}");
    let observations = observations.unwrap();
    assert_eq!(observations.rows.len(), 12);
    // The job says nothing of the bar, so its usual 2 um (`sigma_um`) are the least.
    assert!(observations.rows.iter().all(|row| row.sigma_mm.unwrap() >= 0.002));
    let kinds: Vec<&str> = observations.rows.iter().map(|row| row.extra[0].as_str()).collect();
    assert_eq!((kinds[0], kinds[1]), ("reference", "measure"));

    let (output, observations) = through_the_binary(&plan, &run, false);
    assert_eq!(output.status.code(), Some(3), "a run that was cut off is a doubt");
    assert_eq!(observations.unwrap().rows.len(), 12);

    run.samples.clear();
    let (output, observations) = through_the_binary(&plan, &run, true);
    assert_eq!(output.status.code(), Some(1));
    assert!(observations.is_none() && String::from_utf8_lossy(&output.stderr).contains("no sample"));
}

#[test]
fn a_capture_becomes_a_circular_test() {
    let job = r#"
        robot = "kr60ha"
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
    let plan = Plan::build(&job, &Robot::by_name("kr60ha").unwrap().unwrap()).unwrap();
    let places: Vec<_> = plan
        .rows
        .iter()
        .zip(plan.circle_places())
        .filter(|(row, _)| row.kind == Kind::Measure)
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
    let observations = Observations::from_csv("obs.csv", &observations).unwrap();
    assert_eq!(observations.extra_columns[4..], ["circle", "angle_deg"]);
    for (index, place) in &places {
        let row = observations.rows.iter().find(|row| row.index == *index).unwrap();
        assert_eq!(row.extra[4..], ["1".to_owned(), place.angle_deg.to_string()]);
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
    let reversals = json["joint_reversals"].as_array().unwrap();
    // On a full circle axis 1 swings out and back once: it reverses at both sides, in either sense.
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
