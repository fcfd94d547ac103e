//! Intervals with the right degrees of freedom, Monte Carlo, the effect of the prior, and edge cases: no scatter, no lengths,
//! only outliers, absurd standard deviations.

use std::fs;
use std::path::Path;
use std::process::Command;

use dbbd_model::diagnostic::RecordedFinding;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::{SigmaSource, Status};
use dbbd_model::measurement::Measurements;
use dbbd_model::robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, DESIGNED, centres_csv, codes, dbbd, kr60, measure, stderr, three_planes, with_errors,
};

const THIRTEEN: [&str; 2] = ["--estimate", "alpha1-5,a1-5,d4-6"];

fn lengths(points: usize, noise_mm: f64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(11);
    let mut data = measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), points, 25.0);
    for row in &mut data.rows {
        let z: f64 = StandardNormal.sample(&mut random);
        row.length_mm += noise_mm * z;
    }
    data
}

fn cell(data: &Measurements) -> TempDir {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
    fs::write(dir.path().join("C.csv"), centres_csv(&three_planes(1, CENTRE))).unwrap();
    dir
}

const BASE: [&str; 11] = [
    "identify",
    "--verbose",
    "obs.csv",
    "--robot",
    "kr60ha",
    "--tool",
    "30,20,10",
    "--centres",
    "C.csv",
    "--out",
    "out",
];

/// Exit code, result and output.
fn run(dir: &Path, extra: &[&str]) -> (i32, Option<CalibrationResult>, String) {
    let output = dbbd(dir, &[&BASE[..], extra].concat());
    let text = fs::read_to_string(dir.join("out/result.json")).ok();
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().unwrap(), text.map(|text| serde_json::from_str(&text).unwrap()), said)
}

fn identify(dir: &Path, extra: &[&str]) -> (CalibrationResult, String) {
    let (code, result, said) = run(dir, extra);
    assert!(matches!(code, 0 | 3), "{said}");
    (result.unwrap(), said)
}

fn half_widths(result: &CalibrationResult) -> Vec<f64> {
    let known = result.parameters.iter().filter_map(|p| Some((p.interval95?, p.sd?)));
    known.map(|([low, high], sd)| 0.5 * (high - low) / sd).collect()
}

/// 81 lengths, 13 parameters: Student's t with 68 degrees of freedom has its 97.5 % point at 1.9955 (tables).
#[test]
fn intervals_with_estimated_sigma_use_students_t() {
    let dir = cell(&lengths(27, 0.01));
    let (estimated, said) = identify(dir.path(), &THIRTEEN);
    assert_eq!(
        (estimated.sigma_source, estimated.noise_mm.degrees_of_freedom),
        (SigmaSource::Estimated, Some(68.0))
    );
    assert!(said.contains("(estimated)"), "{said}");
    assert_eq!(half_widths(&estimated).len(), 13);
    assert!(half_widths(&estimated).iter().all(|factor| (factor - 1.9955).abs() < 5e-5));
    let report = fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(
        report.contains("1.995 sd (Student's t with 68 degrees of freedom, because sigma was estimated)")
    );

    let (given, said) = identify(dir.path(), &[&THIRTEEN[..], &["--sigma", "0.01"]].concat());
    assert_eq!((given.sigma_source, given.noise_mm.degrees_of_freedom), (SigmaSource::Given, None));
    assert!(said.contains("(given)"), "{said}");
    assert!(half_widths(&given).iter().all(|factor| (factor - 1.96).abs() < 5e-5));
    let report = fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(report.contains("1.960 sd (normal, because sigma was given)"));
    let table = fs::read_to_string(dir.path().join("out/parameters.csv")).unwrap();
    assert!(table.lines().next().unwrap().ends_with(",reason,low95,high95,mc_sd,mc_low95,mc_high95"));

    // Residuals that agree with sigma_mm do not change it.
    let mut sure = lengths(27, 0.01);
    sure.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.01));
    let (sure, _) = identify(cell(&sure).path(), &THIRTEEN);
    assert_eq!((sure.sigma_source, sure.coverage_factor), (SigmaSource::Given, given.coverage_factor));
}

#[test]
fn monte_carlo_agrees_in_the_linear_range() {
    let dir = cell(&lengths(27, 0.01));
    let (result, said) =
        identify(dir.path(), &[&THIRTEEN[..], &["--sigma", "0.01", "--monte-carlo", "1000"]].concat());
    assert!(said.contains("Monte Carlo, 1000 trials: the linear 95 % intervals hold"), "{said}");
    for parameter in result.parameters.iter().filter(|p| p.status == Status::Identified) {
        let drawn = parameter.monte_carlo.unwrap();
        // The standard error of a standard deviation from 1000 draws is 1 / sqrt(2000).
        assert!((drawn.sd / parameter.sd.unwrap() - 1.0).abs() < 4.0 / 2000f64.sqrt(), "{}", parameter.name);
        assert!(drawn.interval95[0] < parameter.identified && parameter.identified < drawn.interval95[1]);
    }
    let report = fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(result.monte_carlo.as_ref().is_some_and(|drawn| drawn.used == 1000 && drawn.disagree.is_empty()));
    assert!(report.contains("Monte Carlo<br>95 % interval"));
    let table = fs::read_to_string(dir.path().join("out/parameters.csv")).unwrap();
    let alpha1 = table.lines().find(|line| line.starts_with("alpha1,")).unwrap();
    assert!(alpha1.rsplit(',').take(5).all(|cell| cell.parse::<f64>().is_ok()), "{alpha1}");
}

/// The sources of the linearised uncertainty besides noise are drawn too: the uncertainty of sigma, errors of fixed poorly
/// observable parameters, the prior.
#[test]
fn monte_carlo_draws_all_linearised_sources() {
    let dir = cell(&lengths(14, 0.01));
    for extra in [vec![], vec!["--prior", "datasheet"]] {
        let (result, said) =
            identify(dir.path(), &[&extra[..], &["--monte-carlo", "2000", "--folds", "0"]].concat());
        assert!(result.monte_carlo.as_ref().unwrap().disagree.is_empty(), "{said}");
        for parameter in &result.parameters {
            let (Some(drawn), Some(linear)) = (parameter.monte_carlo, parameter.interval95) else { continue };
            let share = (drawn.interval95[1] - drawn.interval95[0]) / (linear[1] - linear[0]);
            assert!((share - 1.0).abs() < 0.15, "{extra:?} {}: {share}", parameter.name);
        }
    }
}

/// A sigma as large as a fifth of the bar: the ball lies on a sphere, not on its tangent.
#[test]
fn monte_carlo_reports_nonlinearity() {
    let dir = cell(&lengths(5, 0.01));
    let options = ["--estimate", "centres,tool", "--sigma", "60", "--monte-carlo", "1000", "--folds", "0"];
    let (result, said) = identify(dir.path(), &options);
    let disagree = &result.monte_carlo.as_ref().unwrap().disagree;
    assert!(!disagree.is_empty(), "{:?}", result.parameters);
    assert!(said.contains("the linear 95 % intervals do not hold for"), "{said}");
    assert!(result.findings.iter().any(|w| w.code() == "I1325"));
    let report = fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(report.contains("differ from the linear ones"));

    // With noise of ten bar lengths many draws have no minimum nearby.
    let options = ["--estimate", "centres,tool", "--sigma", "3000", "--monte-carlo", "300", "--folds", "0"];
    let (code, result, said) = run(dir.path(), &options);
    let drawn = result.unwrap().monte_carlo.unwrap();
    assert!(code == 3 && drawn.used < drawn.trials, "{said}");
    assert!(said.contains("W1324"), "{said}");
}

#[test]
#[cfg(target_os = "linux")]
fn monte_carlo_is_the_same_on_one_core() {
    let dir = cell(&lengths(9, 0.01));
    let options = [&THIRTEEN[..], &["--monte-carlo", "300", "--folds", "0"]].concat();
    run(dir.path(), &options);
    let both = fs::read(dir.path().join("out/result.json")).unwrap();
    let pinned = Command::new("taskset")
        .args(["-c", "0", env!("CARGO_BIN_EXE_dbbd")])
        .args([&BASE[..], &options].concat())
        .current_dir(dir.path())
        .output()
        .expect("taskset of util-linux");
    assert!(matches!(pinned.status.code(), Some(0 | 3)), "{}", stderr(&pinned));
    assert_eq!(both, fs::read(dir.path().join("out/result.json")).unwrap());
}

#[test]
fn prior_files_are_checked() {
    let dir = cell(&lengths(9, 0.01));
    for (text, words) in [
        ("name,unit,sd\nalpha9,rad,0.001\n", "error[E0501]: prior.csv:2:"),
        ("name,unit,sd\na1,mm,0.1\ncentre2_x,mm,1\n", "prior.csv:3:"),
        ("name,unit,sd\na1,rad,0.1\n", "error[E1304]: prior.csv:2:"),
        ("name,unit,sd\na1,mm,-0.1\n", "prior.csv:2:"),
        ("name,unit,sd\na1,mm,0.1\na1,mm,0.2\n", "error[E1304]: prior.csv:3:"),
        ("name,sd\na1,0.1\n", "prior.csv:1:"),
    ] {
        fs::write(dir.path().join("prior.csv"), text).unwrap();
        let (code, _, said) = run(dir.path(), &["--prior", "prior.csv"]);
        assert_eq!(code, 1, "{said}");
        assert!(said.contains(words), "`{words}` is not in: {said}");
    }
}

#[test]
fn meaningless_lengths_have_warnings() {
    let mut random = Pcg64::seed_from_u64(3);
    let mut data = lengths(20, 0.01);
    data.rows.iter_mut().for_each(|row| row.length_mm = random.random_range(50.0..900.0));
    for extra in [vec![], vec!["--prior", "datasheet"], THIRTEEN.to_vec()] {
        let (code, result, said) = run(cell(&data).path(), &extra);
        assert_eq!(code, 3, "{extra:?}: {said}");
        let expected = |w: &RecordedFinding| ["W1311", "W1312", "W1322"].contains(&w.code());
        assert!(result.unwrap().findings.iter().any(expected), "{extra:?}: {said}");
    }
}

/// A sigma that is far too small gives a warning, one that is far too large changes nothing; neither crashes.
#[test]
fn absurd_sigmas_are_reported() {
    let dir = cell(&lengths(27, 0.01));
    let (code, _, said) = run(dir.path(), &["--sigma", "1e-12", "--folds", "0"]);
    assert_eq!(code, 3, "{said}");
    assert!(said.contains("W1316"), "{said}");
    let (_, result, said) = run(dir.path(), &["--sigma", "1e9", "--folds", "0"]);
    let result = result.unwrap();
    assert!(result.parameters.iter().all(|p| p.status != Status::Identified
        || p.name.to_string().starts_with("centre")
        || p.name.to_string().starts_with("tool")));
    assert!(said.contains("W1319"), "{said}");
    for sigma in ["0", "nan", "inf", "one"] {
        assert_eq!(run(dir.path(), &["--sigma", sigma]).0, 2, "{sigma}");
    }
    let mut wide = lengths(27, 0.01);
    wide.rows.iter_mut().for_each(|row| row.sigma_mm = Some(1e200));
    let (code, _, said) = run(cell(&wide).path(), &["--folds", "0"]);
    assert!(matches!(code, 1 | 3), "{said}");
}

/// Two lengths more than parameters, with the noise of a good bar: the repeatability in the robot file still applies, as in a
/// plan.
#[test]
fn few_lengths_do_not_lower_the_repeatability() {
    let mut few = lengths(27, 0.0015);
    few.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.0015));
    few.rows.truncate(15);
    let (result, said) = identify(cell(&few).path(), &THIRTEEN);
    let planned_mm = 0.0015f64.hypot(0.05 / 3.616);
    assert!((0.6 * planned_mm..1.2 * planned_mm).contains(&result.noise_mm.length), "{said}");
    let freedom = result.noise_mm.degrees_of_freedom.unwrap();
    assert!((freedom - 2.0).abs() < 1e-6, "{said}");
    // 68 more lengths show that the noise is that of the bar alone.
    let mut many = lengths(27, 0.0015);
    many.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.0015));
    let (result, said) = identify(cell(&many).path(), &THIRTEEN);
    assert_eq!((result.noise_mm.length, result.sigma_source), (0.0015, SigmaSource::Given), "{said}");
}

/// A robot file without repeatability gives a finding.
#[test]
fn a_missing_repeatability_is_reported() {
    let dir = cell(&lengths(20, 0.01));
    let toml = kr60().to_toml().unwrap();
    let silent: String = toml
        .lines()
        .filter(|line| !line.starts_with("repeatability"))
        .fold(String::new(), |text, line| text + line + "\n");
    for (text, asked) in [(&toml, false), (&silent, true)] {
        fs::write(dir.path().join("robot.toml"), text).unwrap();
        let args = ["identify", "obs.csv", "--robot", "robot.toml", "--centres", "C.csv", "--out", "out"];
        let output = dbbd(dir.path(), &args);
        assert_eq!(codes(&output).iter().any(|code| code == "I0510"), asked, "{}", stderr(&output));
    }
    let impossible = toml.replace("repeatability_mm = 0.05", "repeatability_mm = -0.05");
    assert_eq!(Robot::from_toml("robot.toml", &impossible).unwrap_err().code().as_str(), "E0130");
}

/// As many lengths as parameters: an answer, but no interval, since sigma is unknown.
#[test]
fn no_interval_without_a_sigma() {
    let mut few = lengths(27, 0.0);
    few.rows.truncate(13);
    let (code, result, said) = run(cell(&few).path(), &THIRTEEN);
    let result = result.unwrap();
    assert_eq!((code, result.sigma_source), (3, SigmaSource::Assumed), "{said}");
    assert!(said.contains("W1315") && said.contains("(assumed)"), "{said}");
    assert!(result.parameters.iter().all(|parameter| parameter.interval95.is_none()));
}
