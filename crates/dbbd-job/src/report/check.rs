//! `check.html`: the interim check of a calibrated robot.

use serde::Serialize;

use super::page::render;
use super::plot::HeatMap;
use super::scale::Unit;
use super::verdict::Verdict;
use dbbd_model::conformity::InterimCheck;
use dbbd_model::conformity::change::Hypothesis;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::DistanceQuantities;
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::ParamUnit;

#[derive(Serialize)]
struct Page<'a> {
    check: &'a InterimCheck,
    hypotheses: Vec<Row>,
    maps: Vec<String>,
    findings: Vec<Diagnostic>,
    verdict: Verdict,
    distance: Option<&'a DistanceQuantities>,
    provenance: &'a Provenance,
}

/// A hypothesis of what changed, in mm and degrees.
#[derive(Serialize)]
struct Row {
    parts: Vec<Part>,
    alike: Vec<String>,
    probability: f64,
    p_rest: f64,
}

#[derive(Serialize)]
struct Part {
    name: String,
    unit: &'static str,
    change: f64,
    sd: f64,
    interval95: [f64; 2],
}

pub fn html(
    check: &InterimCheck,
    distance: Option<&DistanceQuantities>,
    findings: &[Diagnostic],
    provenance: &Provenance,
) -> Result<String, Diagnostic> {
    let page = Page {
        check,
        hypotheses: check.changes.iter().map(row).collect(),
        maps: HeatMap::of_positions("Position error of the robot file now", &check.map),
        findings: findings.to_vec(),
        verdict: Verdict::of_check(check),
        distance,
        provenance,
    };
    render("check.html", include_str!("check.html"), &page)
}

fn row(hypothesis: &Hypothesis) -> Row {
    let part = |at: usize| {
        let id = hypothesis.parameters[at];
        let unit = match id.unit() {
            ParamUnit::Mm => Unit::MM,
            ParamUnit::Rad => Unit::DEG,
            other @ ParamUnit::RadPerNm => Unit { sign: other.name(), factor: 1.0 },
        };
        let Unit { sign, factor } = unit;
        Part {
            name: id.to_string(),
            unit: sign,
            change: hypothesis.change[at] * factor,
            sd: hypothesis.sd[at] * factor,
            interval95: hypothesis.interval95[at].map(|end| end * factor),
        }
    };
    Row {
        parts: (0..hypothesis.parameters.len()).map(part).collect(),
        alike: hypothesis.alike.iter().map(ToString::to_string).collect(),
        probability: hypothesis.probability,
        p_rest: hypothesis.p_rest,
    }
}
