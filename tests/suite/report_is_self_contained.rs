//! The pages stand alone: well-formed, escaped, nothing fetched, nothing lost, the same bytes again.
//!
//! With `DBBD_PAGES=DIR` the pages made here are also written to DIR, to be looked at.

mod made_up;

use dbbd::identify::result::Identification;
use dbbd::report::plot::{HeatMap, PolarPlot, PolarTrace, Series};
use dbbd::report::{IdentificationPlots, PlanView, identification, plan, svg};
use made_up::{heat_map, noise, plots};
use proptest::prelude::*;

/// Every element that is opened is closed in order; attributes are quoted.
fn assert_well_formed(html: &str) {
    const VOID: [&str; 3] = ["meta", "br", "!doctype"];
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

/// Nothing that a browser would fetch or run, and no number that is none.
fn assert_self_contained(html: &str) {
    for word in ["http:", "https:", "//", "src=", "url(", "@import", "<link", "<script", "NaN", "=\"inf"] {
        assert!(!html.contains(word), "the page holds {word}");
    }
}

fn keep(name: &str, text: &str) {
    if let Some(folder) = std::env::var_os("DBBD_PAGES") {
        std::fs::write(std::path::Path::new(&folder).join(name), text).unwrap();
    }
}

const HOSTILE: &str = "<b>& \"KR\" '60'</b>";
const HOSTILE_ESCAPED: &str = "&lt;b&gt;&amp; ";

#[test]
fn the_report_tells_everything() {
    let result = made_up::identification("KUKA KR 60 HA");
    let html = identification::html(&result, &plots()).unwrap();
    keep("report.html", &html);
    assert_well_formed(&html);
    assert_self_contained(&html);
    for parameter in &result.parameters {
        let row = format!("<td class=\"mono\">{}</td>", parameter.name);
        assert_eq!(html.matches(&row).count(), 1, "{row}");
        assert!(html.contains(&parameter.reason));
    }
    assert!(html.contains("The reference pose drifted by 0.034 mm"));
    assert!(html.contains("turn the wrist more &amp; repeat &lt;b&gt;."));
    assert!(html.find("Do not use this result") < html.find("The rms residual"), "the doubts come first");
    assert!(html.contains("fell from 0.413 mm to 0.0103 mm"));
    assert!(html.contains("only d2 + d3 can be told"));
    assert!(html.contains("97.2130"), "the outlier's residual");
    for needle in
        ["0.610", "0.180", "−0.9731", "some 0.17 mrad between rising and falling", "−0.0314", "Axis 6"]
    {
        assert!(html.contains(needle), "{needle}");
    }
    assert_eq!(html, identification::html(&result, &plots()).unwrap());
}

#[test]
fn the_plan_tells_everything() {
    let html = plan::html(&made_up::plan(), &made_up::plan_view("KUKA KR 60 HA")).unwrap();
    keep("plan.html", &html);
    assert_well_formed(&html);
    assert_self_contained(&html);
    for needle in
        ["0123456789abcdef", "Stroke risk", "8.1 deg", "row 12, circle 1", "14 min 20 s", "Checks failed: 1"]
    {
        assert!(html.contains(needle), "{needle}");
    }
    assert_eq!(html, plan::html(&made_up::plan(), &made_up::plan_view("KUKA KR 60 HA")).unwrap());
}

#[test]
fn text_is_escaped() {
    let mut result = made_up::identification(HOSTILE);
    result.parameters[0].reason = HOSTILE.into();
    result.parameters[1].name = HOSTILE.into();
    let mut plots = plots();
    plots.circles[0].name = HOSTILE.into();
    plots.provenance.robot = HOSTILE.into();
    let report = identification::html(&result, &plots).unwrap();
    for html in [report, plan::html(&made_up::plan(), &made_up::plan_view(HOSTILE)).unwrap()] {
        assert!(html.contains(HOSTILE_ESCAPED) && !html.contains(HOSTILE));
        assert_well_formed(&html);
    }
}

#[test]
fn empty_and_undefined_data_break_nothing() {
    let mut result = made_up::identification("r");
    for parameter in &mut result.parameters {
        (parameter.identified, parameter.correction, parameter.sd) =
            (f64::NAN, f64::NAN, Some(f64::INFINITY));
    }
    result.residual_mm.after.rms = f64::NAN;
    let mut broken = plots();
    for observation in &mut broken.observations {
        observation.after_mm = f64::NAN;
    }
    broken.maps[0].values_mm.fill(f64::NAN);
    let html = identification::html(&result, &broken).unwrap();
    assert_well_formed(&html);
    let without_titles = html.replace("correction NaN", "").replace("identified NaN", "");
    assert_self_contained(&without_titles);

    result = Identification {
        parameters: vec![],
        dependent: vec![],
        correlated: vec![],
        advice: vec![],
        joints: vec![],
        outliers: vec![],
        warnings: vec![],
        ..result
    };
    let html = identification::html(&result, &IdentificationPlots::default()).unwrap();
    assert_well_formed(&html);
    assert!(!html.contains("<svg"));

    let mut nothing = made_up::plan();
    nothing.rows.clear();
    assert_well_formed(&plan::html(&nothing, &PlanView::default()).unwrap());
    let mut rows = made_up::plan();
    rows.rows[3].length_mm = f64::NAN;
    rows.rows[4].axes_deg[2] = f64::INFINITY;
    assert_self_contained(&plan::html(&rows, &PlanView::default()).unwrap());
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
        axis_names: None,
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
    let plot = PolarPlot { title: "p".into(), radius_mm: Some(150.0), axis_names: None, traces }.to_svg();
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
        let plot = PolarPlot { title: "p".into(), radius_mm: values.first().map(|v| v.1), axis_names: None, traces };
        let map = HeatMap { values_mm: values.iter().map(|v| v.1).collect(), ..heat_map() };
        for text in [plot.to_svg(), map.to_svg()] {
            assert_well_formed(&text);
            assert!(!text.contains("=\"NaN") && !text.contains("inf"), "{text}");
        }
    }
}
