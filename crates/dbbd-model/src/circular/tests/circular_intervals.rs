//! Coverage of the intervals of the circular test.

use dbbd_model::circular::{CircularEvaluation, CircularSettings, QUANTITY_NAMES, circular};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use crate::test_support::circular_cases::{CASES, Case, exactly};

/// Noise of a length, mm.
const SIGMA_MM: f64 = 0.001;

/// How often the interval of each quantity covers the true value in this many runs.
fn coverage(case: Case, sigma_mm: Option<f64>, runs: u64) -> [u64; 9] {
    let truth = exactly(&case.traces(), case.radius);
    let noise = Normal::new(0.0, SIGMA_MM).unwrap();
    let value = |found: &CircularEvaluation, name: &str| found.get(name).value.unwrap();
    let mut covered = [0; 9];
    let mut width_um = [0.0; 9];
    for seed in 0..runs {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut traces = case.traces();
        traces.iter_mut().flat_map(|t| &mut t.points).for_each(|p| p.length_mm += noise.sample(&mut random));
        // Equal draws in all runs would make their errors common to the whole campaign.
        let settings = CircularSettings {
            sigma_mm,
            draws: 300,
            seed: runs + seed,
            ..CircularSettings::new(case.radius)
        };
        let found = circular(&traces, &settings).unwrap();
        for (at, name) in QUANTITY_NAMES.into_iter().enumerate() {
            let u95 = found.get(name).u95.unwrap();
            covered[at] += u64::from((value(&found, name) - value(&truth, name)).abs() <= u95);
            width_um[at] += 1000.0 * u95 / runs as f64;
        }
    }
    let found = QUANTITY_NAMES.iter().zip(covered).zip(width_um.map(|width| (100.0 * width).round() / 100.0));
    eprintln!(
        "{} points, plays {:?} mm, sigma {sigma_mm:?}: of {runs} intervals cover (mean half width, um) {:?}",
        case.points,
        case.backlash,
        found.collect::<Vec<_>>()
    );
    covered
}

#[test]
fn intervals_cover_the_truth() {
    let covered = coverage(CASES[0], Some(SIGMA_MM), 60);
    // 57 of 60 are expected, 51 is 3.5 standard deviations below.
    assert!(covered.iter().all(|count| *count >= 51), "{covered:?}");
}

#[test]
#[ignore = "a campaign"]
fn intervals_cover_the_truth_in_1000_runs() {
    let case = CASES[0];
    let covered = coverage(case, Some(SIGMA_MM), 1000);
    assert!(covered.iter().all(|count| (930..=990).contains(count)), "{covered:?}");
    // No hysteresis, and as much as the noise; few and many points; noise that is estimated from the lengths.
    for (backlash, points, sigma_mm) in [
        ([0.0; 2], 72, Some(SIGMA_MM)),
        ([0.0, 0.002], 72, Some(SIGMA_MM)),
        (case.backlash, 24, Some(SIGMA_MM)),
        (case.backlash, 360, Some(SIGMA_MM)),
        (case.backlash, 360, None),
    ] {
        let covered = coverage(Case { backlash, points, ..case }, sigma_mm, 1000);
        assert!(covered.iter().all(|count| *count >= 910), "{covered:?}");
    }
}
