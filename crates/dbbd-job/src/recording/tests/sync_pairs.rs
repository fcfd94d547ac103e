//! A dwell is paired with the pose that commanded it or with none, never with another one.
//!
//! The bounds are those of the alignment study that the design rests on: 80 dwells of 2 s, 10 % missed,
//! 10 % spurious, override 0.5..1, a 30 s pause; with distinct move times 0 wrong and 0.8 % dropped,
//! with equal moves 72 % dropped and 0 wrong.

use dbbd_job::recording::matching::{CommandedDwell, DwellEvidence, ExpectedLengths, Pairing, align};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

const POSES: usize = 80;
const WAIT_S: f64 = 1.6;
const STILL_S: f64 = 0.8;

/// Disturbances of a run.
#[derive(Clone, Copy)]
struct Trouble {
    missed: f64,
    spurious: f64,
    lost_first: usize,
    split: f64,
    /// Share of the dwells that merge with the next one.
    merged: f64,
    pauses: usize,
}

const STUDY: Trouble =
    Trouble { missed: 0.1, spurious: 0.1, lost_first: 6, split: 0.03, merged: 0.0, pauses: 1 };

/// Disturbances of a difficult run, drawn again for each run.
fn drawn(seed: u64) -> Trouble {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x5eed);
    let mut share = |most: f64| rng.random_range(0.0..=most);
    let (missed, spurious, split, merged) = (share(0.1), share(0.1), share(0.05), share(0.05));
    Trouble { missed, spurious, split, merged, lost_first: 6, pauses: (share(3.0)) as usize }
}

/// Commanded dwells, the detected starts, the true pose of each, and the override.
struct Run {
    poses: Vec<CommandedDwell>,
    seen: Vec<DwellEvidence>,
    truth: Vec<Option<usize>>,
    override_factor: f64,
    /// Lengths that a model predicts, mm.
    expected_mm: Vec<f64>,
}

/// Range of the uniform error of the model, mm.
const START_ERROR_MM: f64 = 1.0;

fn run(seed: u64, distinct: bool, trouble: Trouble) -> Run {
    run_of(seed, POSES, POSES, distinct, trouble)
}

/// A run of `count` poses in modules of `per_module`, each started by hand.
fn run_of(seed: u64, count: usize, per_module: usize, distinct: bool, trouble: Trouble) -> Run {
    let mut rng = Pcg64::seed_from_u64(seed);
    let override_factor = rng.random_range(0.5..1.0);
    let poses: Vec<CommandedDwell> = (0..count)
        .map(|pose| (pose, if distinct { rng.random_range(0.8..3.0) } else { 1.9 }))
        .map(|(pose, move_s)| CommandedDwell { move_s, wait_s: WAIT_S, module: pose / per_module })
        .collect();
    let pauses: Vec<usize> = (0..trouble.pauses).map(|_| rng.random_range(0..count)).collect();
    let lost = if trouble.lost_first == 0 { 0 } else { rng.random_range(0..=trouble.lost_first) };
    let noise = Normal::new(0.0, 0.05).unwrap();
    // Start, duration of stillness, and true pose.
    let mut events: Vec<(f64, f64, Option<usize>)> = Vec::new();
    let mut t = 20.0;
    if lost == 0 {
        events.push((3.0, 12.0, None)); // standing at HALT
    }
    let mut merging = false;
    for (pose, commanded) in poses.iter().enumerate() {
        if pose > 0 && pose % per_module == 0 {
            // The operator handles the bar and starts the next module.
            let by_hand_s = rng.random_range(10.0..120.0);
            events.push((t + 2.0, by_hand_s - 3.0, None));
            t += by_hand_s;
        }
        let move_s = commanded.move_s / override_factor * (1.0 + 0.1 * noise.sample(&mut rng));
        if pauses.contains(&pose) {
            events.push((t + 0.5 * move_s, 30.0, None)); // it stands still in the middle of the move
            t += 30.0;
        } else if move_s > STILL_S + 0.2 && rng.random_bool(trouble.spurious * 1.2) {
            // A spurious still interval has a least duration, and the robot moves on after it.
            let still_s = rng.random_range(STILL_S..move_s - 0.1);
            events.push((t + rng.random_range(0.0..move_s - still_s), still_s, None));
        }
        t += move_s;
        if pose >= lost {
            let roll: f64 = rng.random();
            let before = if std::mem::take(&mut merging) { events.last_mut() } else { None };
            if let Some(before) = before.filter(|before| before.2 == pose.checked_sub(1)) {
                before.1 = t + commanded.wait_s - before.0;
            } else if roll < trouble.split {
                let cut_s = rng.random_range(0.3..1.0);
                events.push((t + noise.sample(&mut rng), cut_s, Some(pose)));
                events.push((t + cut_s + 0.1, WAIT_S - cut_s - 0.1, None));
            } else if roll > trouble.missed + trouble.split {
                let late_s = noise.sample(&mut rng);
                events.push((t + late_s, WAIT_S - late_s + noise.sample(&mut rng), Some(pose)));
                merging = trouble.merged > 0.0 && rng.random_bool(trouble.merged);
            }
        }
        t += commanded.wait_s;
    }
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    let swing = Normal::new(0.0, 0.3).unwrap();
    let true_mm: Vec<f64> = poses.iter().map(|_| 300.0 + swing.sample(&mut rng)).collect();
    let expected_mm =
        true_mm.iter().map(|mm| mm + rng.random_range(-START_ERROR_MM..START_ERROR_MM)).collect();
    let seen = events
        .iter()
        .map(|&(start_s, lasts_s, pose)| DwellEvidence {
            start_s,
            start_sd_s: 0.06,
            duration_s: Some(lasts_s),
            length_mm: pose.map_or(300.0, |pose| true_mm[pose]),
            after_break: false,
        })
        .collect();
    let truth = events.iter().map(|event| event.2).collect();
    Run { poses, seen, truth, override_factor, expected_mm }
}

#[derive(Debug, Default)]
struct Score {
    sound: usize,
    kept: usize,
    wrong: usize,
    worst_override: f64,
}

fn score(seeds: std::ops::Range<u64>, distinct: bool, trouble: Trouble) -> Score {
    score_runs(seeds.map(|seed| (seed, run(seed, distinct, trouble))), false)
}

/// With `model` the predicted lengths count too.
fn score_runs(runs: impl Iterator<Item = (u64, Run)>, model: bool) -> Score {
    let mut score = Score::default();
    for (seed, run) in runs {
        let expected =
            ExpectedLengths { length_mm: &run.expected_mm, sigma_mm: START_ERROR_MM / 3f64.sqrt() };
        let alignment = align(&run.poses, &run.seen, model.then_some(expected));
        score.sound += run.truth.iter().flatten().count();
        for (pose, pairing) in alignment.pairings.iter().enumerate() {
            if let Pairing::Dwell { dwell, .. } = *pairing {
                let right = run.truth[dwell] == Some(pose);
                score.kept += usize::from(right);
                score.wrong += usize::from(!right);
                if !right {
                    eprintln!("seed {seed}: pose {pose} got {:?}", run.truth[dwell]);
                }
            }
        }
        let off = (alignment.override_factor / run.override_factor - 1.0).abs();
        score.worst_override = score.worst_override.max(off);
    }
    score
}

impl Score {
    fn dropped(&self) -> f64 {
        1.0 - self.kept as f64 / self.sound as f64
    }
}

#[test]
fn distinct_moves_pair_most_poses_and_none_wrongly() {
    let score = score(0..60, true, STUDY);
    eprintln!("distinct moves: {score:?}, {:.2} % dropped", 100.0 * score.dropped());
    assert_eq!(score.wrong, 0, "{score:?}");
    assert!(score.dropped() < 0.03, "{score:?}");
    assert!(score.worst_override < 0.01, "{score:?}");
}

#[test]
fn equal_moves_are_dropped_not_paired_wrongly() {
    let score = score(0..8, false, STUDY);
    eprintln!("equal moves: {score:?}, {:.2} % dropped", 100.0 * score.dropped());
    assert_eq!(score.wrong, 0, "{score:?}");
    assert!(score.dropped() > 0.5, "nothing tells the poses apart, yet they were paired: {score:?}");
}

#[test]
fn modules_and_a_model_with_errors_pair_none_wrongly() {
    let runs = |from: u64| (from..from + 3).map(|seed| (seed, run_of(seed, 120, 60, true, drawn(seed))));
    for model in [false, true] {
        let score = score_runs(runs(300), model);
        eprintln!("two modules, model {model}: {score:?}, {:.2} % dropped", 100.0 * score.dropped());
        assert_eq!(score.wrong, 0, "{score:?}");
        assert!(score.dropped() < 0.05, "{score:?}");
    }
}

#[test]
fn split_merged_and_missing_dwells_pair_none_wrongly() {
    // In run 7516 two still intervals, while the first poses were missed, are as far apart as two of those
    // poses, and a third
    // looks like a pause.
    let score = score_runs((7512..7520).map(|seed| (seed, run(seed, true, drawn(seed)))), false);
    eprintln!("drawn trouble: {score:?}, {:.2} % dropped", 100.0 * score.dropped());
    assert_eq!(score.wrong, 0, "{score:?}");
    assert!(score.dropped() < 0.02, "{score:?}");
}

#[test]
#[ignore = "campaigns of 1000 runs of drawn trouble, and of long plans; their figures go to docs/evidence/README.md"]
fn campaign_of_drawn_trouble() {
    for first in [7000, 20_000, 21_000, 22_000] {
        for model in [false, true] {
            let runs = (first..first + 1000).map(|seed| (seed, run(seed, true, drawn(seed))));
            let score = score_runs(runs, model);
            let percent = 100.0 * score.dropped();
            eprintln!("drawn trouble, seeds from {first}, model {model}: {score:?}, {percent:.3} % dropped");
            assert_eq!(score.wrong, 0);
            assert!(score.dropped() < 0.01);
        }
    }
    for model in [false, true] {
        let runs = (300..600).map(|seed| (seed, run_of(seed, 120, 60, true, drawn(seed))));
        let score = score_runs(runs, model);
        eprintln!("two modules of 60, model {model}: {score:?}, {:.3} % dropped", 100.0 * score.dropped());
    }
    let long = (9000..9010).map(|seed| (seed, run_of(seed, 765, 255, true, drawn(seed))));
    let score = score_runs(long, false);
    eprintln!("3 x 255 dwells: {score:?}, {:.3} % dropped", 100.0 * score.dropped());
}

#[test]
#[ignore = "a campaign of 1000 runs, and of 100 with equal moves; its figures go to docs/evidence/README.md"]
fn campaign() {
    for (distinct, seeds) in [(true, 1000..2000), (false, 1000..1100)] {
        let score = score(seeds, distinct, STUDY);
        eprintln!("distinct {distinct}: {score:?}, {:.3} % dropped", 100.0 * score.dropped());
        assert_eq!(score.wrong, 0);
    }
}
