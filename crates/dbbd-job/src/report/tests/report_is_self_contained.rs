//! The pages stand alone: well-formed, escaped, nothing fetched, nothing lost, the same bytes again.
//!
//! With `DBBD_PAGES=DIR` the pages made here are also written to DIR, to be looked at.

use std::sync::Arc;

use dbbd_job::plan::{Job, Plan, PlanningPrior};
use dbbd_job::recording::capture::{CaptureRecord, StampedRecord};
use dbbd_job::report::circle::CircleTest;
use dbbd_job::report::export::mcap::McapFile;
use dbbd_job::report::plot::{HeatMap, Overlay, PolarPlot, PolarTrace, Series};
use dbbd_job::report::{calibration, circle, plan, svg};
use dbbd_model::base::units::HostNs;
use dbbd_model::circular::{self, CircularSettings};
use dbbd_model::conformity::UncertaintyBudget;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::{CompletedCalibration, Options};
use dbbd_model::measurement::{BallId, BaseBall, CircleId, MeasurementContext, Measurements, PoseKind};
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance};
use dbbd_model::robot::Robot;
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::test_support::cell::{CENTRE, DESIGNED, calibrated, kr60, measure, three_planes, with_errors};

/// A repeatable number between -1 and 1.
fn noise(seed: usize) -> f64 {
    ((seed as f64 * 12.9898).sin() * 43758.5453).rem_euclid(2.0) - 1.0
}

/// Every element that is opened is closed in order; attributes are quoted.
fn assert_well_formed(html: &str) {
    const VOID: [&str; 4] = ["meta", "br", "input", "!doctype"];
    let mut open: Vec<&str> = Vec::new();
    let (mut rest, mut elements) = (html, 0);
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        elements += 1;
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes in <{tag}>");
        let name = tag.trim_start_matches('/').split([' ', '\n', '/']).next().unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "closed where it was not open");
        } else if !tag.ends_with('/') && !VOID.contains(&name) {
            open.push(name);
        }
    }
    assert!(elements > 0 && open.is_empty(), "left open: {open:?}");
}

/// Nothing that a browser would fetch, and no number that is none; a script is in the page.
fn assert_self_contained(html: &str) {
    for word in [
        "http:",
        "https:",
        "//",
        "src=",
        "url(",
        "@import",
        "<link",
        "<script src",
        "fetch(",
        "XMLHttp",
        "import(",
        "NaN",
        "=\"inf",
    ] {
        assert!(!html.contains(word), "the page holds {word}");
    }
}

fn keep(name: &str, text: &str) {
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        std::fs::write(std::path::Path::new(&folder).join(name), text).unwrap();
    }
}

/// Places of parts of a page; none where a part is absent.
fn place(html: &str, part: &str) -> usize {
    html.find(part).unwrap_or_else(|| panic!("no {part}"))
}

const HOSTILE: &str = "<b>& \"KR\" '60'</b>";
const HOSTILE_ESCAPED: &str = "&lt;b&gt;&amp; ";

/// A calibration with an outlier and a warning.
fn found(robot: &Robot) -> (CompletedCalibration, Measurements) {
    let mut observations = measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), 27, 25.0);
    for (at, row) in observations.rows.iter_mut().enumerate() {
        row.length_mm += 0.01 * noise(at) + if at == 40 { 7.0 } else { 0.0 };
        row.context = Some(Arc::new(MeasurementContext {
            kind: Some(if at % 20 == 0 { PoseKind::Reference } else { PoseKind::Measure }),
            circle: Some(CircleId::at(at / 27)),
            angle_deg: Some(at as f64 % 27.0 * 360.0 / 27.0),
            ..MeasurementContext::default()
        }));
    }
    let centres = [BaseBall { id: BallId::FIRST, position: Vector3::from(CENTRE) }];
    let options = Options { folds: Some(0), ..Options::default() };
    let mut found = calibrated(robot, &observations, &centres, &options).unwrap();
    found.result.findings.push(Diagnostic::from(EstimationFinding::PartOfRunLost).into());
    (found, observations)
}

fn without_findings(mut found: CompletedCalibration) -> CompletedCalibration {
    found.result.findings.clear();
    found
}

fn provenance(robot: &str) -> Provenance {
    dbbd_job::artefact::made_from([&Artefact::new(ArtefactRole::Measurements, robot, "").into()])
}

fn report(found: &CompletedCalibration, observations: &Measurements) -> String {
    let provenance = provenance(&found.robot.name);
    let budget = UncertaintyBudget::of(found, observations, None, &provenance.identity);
    calibration::html(found, observations, &provenance, &budget).unwrap()
}

#[test]
fn the_report_shows_every_parameter_finding_and_figure() {
    let (found, observations) = found(&kr60());
    let html = report(&found, &observations);
    keep("report.html", &html);
    assert_well_formed(&html);
    assert_self_contained(&html);
    for parameter in &found.result.parameters {
        let row = format!("<td class=\"mono\">{}</td>", parameter.name);
        assert_eq!(html.matches(&row).count(), 1, "{row}");
    }
    for finding in found.diagnostics() {
        assert!(
            html.contains(&format!("<code class=\"code\">{}</code>", finding.code())),
            "{}",
            finding.code()
        );
    }
    // The verdict says that there are warnings; they follow, before all that is folded.
    let order = ["data-verdict=\"undecided\"", "class=\"warning\"", "class=\"contents\"", "class=\"part\""];
    assert!(order.map(|part| place(&html, part)).is_sorted());
    assert!(!report(&without_findings(found.clone()), &observations).contains("data-verdict=\"undecided\""));
    assert_eq!(found.result.outliers.len(), 1);
    for number in [
        found.result.outliers[0].residual_mm,
        found.result.residual_mm.before.max,
        found.result.predicted_position_uncertainty_mm.identified.p95,
    ] {
        let shown = format!("{:.4}", number.abs());
        assert!(html.contains(&shown), "{shown}");
    }
    for recommendation in &found.result.recommendations {
        assert!(html.contains(&format!("{:.3}</td>", recommendation.after_mm)));
    }
    // Two maps, two of each circle, two of the ball, two histograms, six axes, a chart for each kind estimated.
    assert!(html.matches("<svg").count() >= 2 + 6 + 2 + 2 + 6 + 2);
    assert_eq!(html, report(&found, &observations));
}

fn demo_plan() -> (Plan, Robot, String) {
    let job = Job::from_toml(
        "circles.toml",
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/circles.toml")),
    )
    .unwrap();
    let robot = kr60();
    let mut plan = Plan::build(&job, &robot).unwrap();
    let map = plan.predict(&robot, &PlanningPrior::datasheet(&job, &robot));
    plan.header.checks[0].limit = 1e9;
    plan.header.provenance = provenance(HOSTILE);
    let html = plan::html(&plan, &robot, &map).unwrap();
    (plan, robot, html)
}

#[test]
fn the_plan_shows_every_check_and_parameter() {
    let (plan, robot, html) = demo_plan();
    keep("plan.html", &html);
    assert_well_formed(&html);
    assert_self_contained(&html);
    assert!(html.contains(&plan.header.hash));
    assert!(html.contains(HOSTILE_ESCAPED) && !html.contains(HOSTILE));
    let checks = &plan.header.checks;
    assert_eq!(
        checks.iter().filter(|check| html.contains(check.quantity.description())).count(),
        checks.len()
    );
    assert_eq!(html.matches("class=\"failed\"").count(), 1);
    assert!(place(&html, "class=\"warning\"") < place(&html, "aria-label=\"Summary\""));
    for parameter in &plan.header.predictions.as_ref().unwrap().parameters {
        assert!(html.contains(&format!("<td class=\"mono\">{}</td>", parameter.name)), "{}", parameter.name);
    }
    // Reading, two of each projection, six axes, manipulability, two maps.
    assert_eq!(html.matches("<svg").count(), 1 + 6 + 6 + 1 + 2);

    let page = |plan: &Plan| plan::html(plan, &robot, &[]).unwrap();
    let mut broken = plan.clone();
    (broken.rows[3].length_mm, broken.rows[4].axes_deg[2]) = (f64::NAN, f64::INFINITY);
    assert_self_contained(&page(&broken));
    broken.rows.clear();
    broken.header.predictions = None;
    let nothing = page(&broken);
    assert_well_formed(&nothing);
    assert!(!nothing.contains("<svg"));
}

#[test]
fn the_circle_page_shows_every_quantity_and_note() {
    let mut csv = String::from("run,direction,angle_deg,length_mm\n");
    for (direction, sign) in [("ccw", 1.0), ("cw", -1.0)] {
        for n in 0..72usize {
            let angle = sign * 5.0 * n as f64;
            let length = 150.0 + 0.004 * (2.0 * angle.to_radians()).cos() + 0.0005 * noise(n);
            csv.push_str(&format!("1,{direction},{angle},{length}\n"));
        }
    }
    let traces = circular::traces_from_csv("circle.csv", &csv).unwrap();
    let evaluation =
        circular::circular(&traces, &CircularSettings { draws: 50, ..CircularSettings::new(150.0) }).unwrap();
    let test = CircleTest { source: HOSTILE.into(), circle: None, evaluation };
    let tests = [test.clone(), test];
    let html = circle::html(&tests, &Provenance::default()).unwrap();
    keep("circle.html", &html);
    assert_well_formed(&html);
    assert_self_contained(&html);
    assert!(html.contains(HOSTILE_ESCAPED) && !html.contains(HOSTILE));
    let found = &tests[0].evaluation;
    let note = |code| html.matches(&format!("<code class=\"code\">{code}</code>")).count();
    assert!(!found.notes.is_empty() && found.notes.iter().all(|found| note(found.code()) >= 2));
    for name in ["G_lsc", "G_mzc", "Gb"] {
        // As many decimals as the uncertainty needs.
        let um = 1e3 * found.get(name).value.unwrap();
        assert!((0..=3).any(|digits| html.contains(&format!(">{um:.digits$}<"))), "{name} {um}");
    }
    assert_eq!(html.matches("<svg").count(), 2);
}

#[test]
fn text_is_escaped() {
    let (found, observations) = found(&Robot { name: HOSTILE.into(), ..kr60() });
    let html = report(&found, &observations);
    assert!(html.contains(HOSTILE_ESCAPED) && !html.contains(HOSTILE));
    assert_well_formed(&html);
}

#[test]
fn empty_and_undefined_data_break_nothing() {
    let (mut found, mut observations) = found(&kr60());
    for parameter in &mut found.result.parameters {
        (parameter.identified, parameter.correction, parameter.sd) =
            (f64::NAN, f64::NAN, Some(f64::INFINITY));
    }
    found.result.residual_mm.after.rms = f64::NAN;
    observations.rows.iter_mut().for_each(|row| row.length_mm = f64::NAN);
    found.map.iter_mut().for_each(|point| point.rms_mm = f64::NAN);
    let html = report(&found, &observations);
    assert_well_formed(&html);
    assert_self_contained(&html.replace("correction NaN", "").replace("identified NaN", ""));

    observations.rows.clear();
    found.result.parameters.clear();
    found.map.clear();
    (found.result.combinations, found.result.correlated, found.result.outliers) = Default::default();
    (found.result.recommendations, found.result.findings) = Default::default();
    (found.result.groups, found.result.joint_errors) = Default::default();
    let html = report(&found, &observations);
    assert_well_formed(&html);
    assert!(!html.contains("<svg"));
}

#[test]
fn a_record_that_is_not_json_is_not_exported() {
    let mut file = McapFile::new(std::io::Cursor::new(Vec::new()), None).unwrap();
    let record = StampedRecord { host: HostNs(0), record: CaptureRecord::Fault(b"{".to_vec()) };
    assert_eq!(file.add(&record).unwrap_err().code().as_str(), "E1702");
}

#[test]
fn a_plot_is_a_file_of_its_own() {
    let trace = |name: &str, series, seed| PolarTrace {
        name: name.into(),
        series,
        points: (0..720).map(|n| [f64::from(n) * 0.5, 0.004 * noise(n as usize + seed)]).collect(),
    };
    let plot = PolarPlot {
        title: "Circular test, XY".into(),
        radius_mm: Some(150.0),
        marks: Vec::new(),
        traces: vec![trace("counter-clockwise", Series::First, 1), trace("clockwise", Series::Second, 5000)],
    };
    let file = svg::standalone(&plot.to_svg());
    keep("polar.svg", &file);
    assert_well_formed(&file);
    assert!(file.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" "));
    assert!(file.contains("prefers-color-scheme") && file.contains("ring spacing 2 µm"));
}

/// Magnification = pixels per mm of deviation over pixels per mm of radius: the ring of no deviation
/// has a radius of 108 px for 150 mm, the outermost one 192 px for 10 um more.
#[test]
fn a_deviation_lies_on_its_ring_and_the_magnification_is_stated() {
    let points = vec![[0.0, 0.010], [90.0, 0.0], [180.0, -0.010]];
    let traces = vec![PolarTrace { name: "t".into(), series: Series::First, points }];
    let plot = PolarPlot { title: "p".into(), radius_mm: Some(150.0), traces, marks: Vec::new() }.to_svg();
    for (dot, ring) in [
        ("cx=\"432\" cy=\"258\"", "r=\"192\""),
        ("cx=\"240\" cy=\"150\"", "r=\"108\""),
        ("cx=\"216\" cy=\"258\"", "r=\"24\""),
    ] {
        assert!(plot.contains(&format!("class=\"d-before\" {dot}")), "{dot}");
        assert!(plot.contains(&format!("cx=\"240\" cy=\"258\" {ring}")), "{ring}");
    }
    let magnification: f64 = (192.0 - 108.0) / 0.010 * 150.0 / 108.0;
    assert_eq!((magnification / 1000.0).round(), 12.0);
    assert!(plot.contains("ring spacing 5 µm; radius 150 mm, deviation magnified 12000 ×"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..Default::default() })]
    #[test]
    fn no_length_breaks_a_plot(values in prop::collection::vec((any::<f64>(), any::<f64>()), 0..12)) {
        let points = values.iter().map(|&(angle, deviation)| [angle, deviation]).collect();
        let traces = vec![PolarTrace { name: "t".into(), series: Series::First, points }];
        let plot = PolarPlot { title: "p".into(), radius_mm: values.first().map(|v| v.1), traces, marks: Vec::new() };
        let map = HeatMap {
            title: "m".into(),
            axis_names: ["X (mm)".into(), "Y (mm)".into()],
            extent: [[600.0, 1800.0], [-400.0, 400.0]],
            columns: 4,
            values_mm: values.iter().map(|v| v.1).collect(),
            overlay: Overlay { arm: values.iter().map(|v| [v.0, v.1]).collect(), balls: Vec::new() },
        };
        for text in [plot.to_svg(), map.to_svg()] {
            assert_well_formed(&text);
            assert!(!text.contains("=\"NaN") && !text.contains("inf"), "{text}");
        }
    }
}
