//! The certificate as a Digital Calibration Certificate (PTB, DCC 3.3.0; numbers as D-SI real).

use serde::Serialize;

use super::Certificate;
use super::sections::{METHOD, NEVER_DETERMINED};
use crate::artefact::VERSION;
use crate::report::page::fill;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::Identity;
use dbbd_model::robot::ParamUnit;

/// Stand-ins where a DCC needs a date or a country and none is stated; ISO 3166-1 leaves ZZ to users.
const NO_DATE: &str = "0001-01-01";
const NO_COUNTRY: &str = "ZZ";
const MM: &str = "\\milli\\metre";

#[derive(Serialize)]
struct Document<'a> {
    draft: &'static str,
    method: &'static str,
    never_determined: [&'static str; 4],
    release: &'a str,
    number: &'a str,
    is_specimen: bool,
    robot: &'a str,
    country: &'a str,
    date: &'a str,
    identity: &'a Identity,
    /// Whether the length of the bar is traceable.
    traceable: bool,
    decision: Option<&'a str>,
    rule: Option<&'a str>,
    /// Identifications of the bar: issuer, value, name.
    bar: Vec<(&'static str, &'a str, &'static str)>,
    conditions: Vec<Quantity>,
    results: [(&'static str, Vec<Quantity>); 4],
}

/// A quantity whose numbers are written in full.
#[derive(Serialize)]
struct Quantity {
    name: String,
    value: String,
    unit: &'static str,
    /// Expanded uncertainty (k = 2).
    expanded: Option<String>,
}

impl Quantity {
    fn new(name: &str, value: f64, unit: &'static str, expanded: Option<f64>) -> Self {
        Self { name: name.into(), value: value.to_string(), unit, expanded: expanded.map(|u| u.to_string()) }
    }
}

pub(super) fn write(certificate: &Certificate) -> Result<Vec<u8>, Diagnostic> {
    let Certificate { provenance, check, result, .. } = certificate;
    let identity = certificate.identity();
    let bar = &identity.bar;
    let document = Document {
        draft: certificate.draft(),
        method: METHOD,
        never_determined: NEVER_DETERMINED,
        release: if provenance.dbbd.is_empty() { VERSION } else { &provenance.dbbd },
        number: certificate.number(),
        is_specimen: certificate.is_specimen(),
        robot: &result.robot,
        country: identity.country.as_deref().unwrap_or(NO_COUNTRY),
        date: identity.measured.as_deref().and_then(|date| date.get(..10)).unwrap_or(NO_DATE),
        identity,
        traceable: certificate.is_traceable(),
        decision: check.as_ref().map(|check| check.decision.as_str()),
        rule: check.as_ref().map(|check| check.rule.as_str()),
        bar: [
            ("manufacturer", &bar.serial, "serial number"),
            ("other", &bar.certificate, "certificate of the length"),
            ("other", &bar.certified_on, "date of the certificate"),
        ]
        .into_iter()
        .filter_map(|(issuer, value, name)| Some((issuer, value.as_deref()?, name)))
        .collect(),
        conditions: identity
            .temperatures
            .iter()
            .map(|t| Quantity::new(&format!("temperature of {}", t.of), t.celsius, "\\degreecelsius", t.u_k))
            .collect(),
        results: results(certificate),
    };
    let text = fill(&[("dcc.xml", include_str!("dcc.xml"))], &document)?;
    // XML 1.0 has no control characters except the end of a line.
    let text = text.replace(|c: char| c.is_control() && c != '\n', " ");
    Ok(format!("{}\n", text.trim()).into_bytes())
}

fn results(certificate: &Certificate) -> [(&'static str, Vec<Quantity>); 4] {
    let Certificate { result, budget, .. } = certificate;
    let mm = |name: &str, value: f64| Quantity::new(name, value, MM, None);
    let (residual, predicted) = (&result.residual_mm, &result.predicted_position_uncertainty_mm);
    let contributions =
        budget.lines.iter().filter_map(|line| Some(mm(line.source.words(), line.position_mm?)));
    let sums = [
        mm("combined standard uncertainty", budget.combined_mm),
        mm("expanded uncertainty (k = 2)", budget.expanded_mm),
    ];
    let estimated = result.parameters.iter().filter_map(|found| {
        let unit = match found.unit {
            ParamUnit::Mm => MM,
            ParamUnit::Rad => "\\radian",
            ParamUnit::RadPerNm => "\\radian\\newton\\tothe{-1}\\metre\\tothe{-1}",
        };
        Some(Quantity::new(&found.name.to_string(), found.identified, unit, Some(2.0 * found.sd?)))
    });
    [
        (
            "Position uncertainty over the workspace",
            vec![
                mm("mean", predicted.identified.mean),
                mm("not exceeded by 95 % of the poses", predicted.identified.p95),
                mm("mean of the nominal robot", predicted.nominal.mean),
            ],
        ),
        (
            "Residual of the lengths",
            vec![
                mm("rms of the nominal robot", residual.before.rms),
                mm("rms of the identified robot", residual.after.rms),
            ],
        ),
        ("Uncertainty budget of the position", contributions.chain(sums).collect()),
        ("Identified parameters", estimated.collect()),
    ]
}
