//! The certificate of a calibration: the same contents as a page for print, as a DCC and, with the feature `pdf`, as a PDF/A-3.
//!
//! It is a draft: a program is not accredited, and its signature fields are empty.

mod catalogue;
pub use catalogue::CertificateFinding;

mod dcc;
#[cfg(feature = "pdf")]
mod pdf;
mod sections;

use serde::{Deserialize, Serialize};

use super::page::render;
use crate::report::certificate::CertificateFinding::{
    CheckOfAnother, CheckOfOtherFile, CheckOfOtherResult, NoBudget, NoCheck, NoResult, NoSuchBall, NotStated,
    OfSimulated, OtherThanCarried, WithWarnings,
};
use dbbd_model::base::hash::sha256;
use dbbd_model::conformity::{Standing, StatedCheck, UncertaintyBudget, standing};
use dbbd_model::diagnostic::Names;
use dbbd_model::diagnostic::{Diagnostic, RecordedFinding, Severity};
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::ParameterResult;
use dbbd_model::provenance::{Artefact, ArtefactRole, Contradiction, Identity, Provenance};
use dbbd_model::robot::{Coordinate, ParamId};
use sections::Section;

#[cfg(feature = "pdf")]
use super::page::capitalised;

const DRAFT: &str = "Draft, not accredited, not signed";
const SPECIMEN: &str = "SPECIMEN, not a certificate";

/// The content of `result.json` with budget and provenance.
#[derive(Deserialize)]
struct ResultRead {
    #[serde(flatten)]
    result: CalibrationResult,
    budget: Option<UncertaintyBudget>,
    #[serde(default)]
    provenance: Provenance,
}

/// The decision in `check.json`.
#[derive(Clone, Debug, Deserialize)]
struct Check {
    robot: String,
    lengths: usize,
    decision: String,
    rule: String,
    tolerance_mm: Option<f64>,
    position_error_mm: f64,
    upper_mm: f64,
    guard_band_mm: Option<f64>,
    specific_risk: Option<f64>,
    #[serde(default)]
    findings: Vec<RecordedFinding>,
    #[serde(default)]
    provenance: Provenance,
}

/// A result, and the decision of an interim check where there is one.
pub struct Certificate {
    result: CalibrationResult,
    budget: UncertaintyBudget,
    provenance: Provenance,
    check: Option<Check>,
    /// What the check states about the calibration, and the day of the certificate.
    stated_check: Option<StatedCheck>,
    today: String,
    /// Contradictions between the identity that is stated now and the identity in the result.
    contradictions: Vec<CertificateFinding>,
    /// First digits of the SHA-256 of `result.json`; `None` for a specimen, which has no number.
    number: Option<String>,
}

#[derive(Serialize)]
struct Page<'a> {
    title: String,
    draft: &'static str,
    is_specimen: bool,
    robot: &'a str,
    number: &'a str,
    measured: &'a str,
    sections: Vec<Section>,
    provenance: &'a Provenance,
}

impl Certificate {
    /// The certificate of the text of `result.json`, on a day.
    pub fn read(text: &str, today: &str) -> Result<Self, CertificateFinding> {
        let read: ResultRead =
            serde_json::from_str(text).map_err(|error| NoResult { why: error.to_string() })?;
        let ResultRead { result, budget, provenance } = read;
        let number = Some(sha256(text).chars().take(16).collect());
        let budget = budget.ok_or(NoBudget)?;
        let (check, stated_check, contradictions) = (None, None, Vec::new());
        Ok(Self {
            result,
            budget,
            provenance,
            check,
            stated_check,
            today: today.into(),
            contradictions,
            number,
        })
    }

    /// Adds the decision in the text of `check.json`; `robot` is the file that was written with the result. Refuses a
    /// check of another robot or another calibration.
    pub fn with_check(self, text: &str, robot: Option<&Artefact>) -> Result<Self, CertificateFinding> {
        let no_check = |error: serde_json::Error| NoCheck { why: error.to_string() };
        let check: Check = serde_json::from_str(text).map_err(no_check)?;
        let stated_check: StatedCheck = serde_json::from_str(text).map_err(no_check)?;
        if check.robot != self.result.robot {
            return Err(CheckOfAnother { robot: self.result.robot, checked: check.robot });
        }
        let is_measured = |source: &&Artefact| source.role == ArtefactRole::Measurements;
        let known = !check.provenance.from.is_empty();
        let measured = self.provenance.from.iter().rev().find(|source| known && is_measured(source));
        if let Some(measured) = measured.filter(|measured| !check.provenance.has(measured)) {
            return Err(CheckOfOtherResult { lengths: measured.to_string() });
        }
        if let Some(robot) = robot.filter(|robot| known && !check.provenance.has(robot)) {
            return Err(CheckOfOtherFile { robot: robot.to_string() });
        }
        Ok(Self { check: Some(check), stated_check: Some(stated_check), ..self })
    }

    /// Whether the calibration may be used on the day of the certificate.
    pub fn standing(&self) -> Standing {
        standing(&(&self.result).into(), self.stated_check.as_ref(), Some(&self.today))
    }

    /// A specimen: it shows how a certificate looks, and has neither a number nor traceability.
    pub fn specimen(self) -> Self {
        Self { number: None, ..self }
    }

    fn is_specimen(&self) -> bool {
        self.number.is_none()
    }

    fn number(&self) -> &str {
        self.number.as_deref().unwrap_or("none")
    }

    /// What is at the head of each page.
    fn draft(&self) -> &'static str {
        if self.is_specimen() { SPECIMEN } else { DRAFT }
    }

    /// Refuses a certificate of simulated readings. A specimen may have them.
    pub fn check_origin(&self) -> Result<(), CertificateFinding> {
        let of_check = self.check.iter().map(|check| &check.provenance);
        let mut all = of_check.chain([&self.provenance]);
        let refused = !self.is_specimen() && all.any(Provenance::is_simulated);
        if refused { Err(OfSimulated) } else { Ok(()) }
    }

    /// Replaces the identity in the result by this identity.
    pub fn with_identity(mut self, identity: &Identity) -> Self {
        let found = self.provenance.identity.contradictions(identity).into_iter();
        self.contradictions = found
            .map(|Contradiction { key, known, stated }| OtherThanCarried { key, carried: known, stated })
            .collect();
        self.provenance.identity.extend(identity);
        self
    }

    pub fn identity(&self) -> &Identity {
        &self.provenance.identity
    }

    /// Whether the bar's length has a certificate with its uncertainty.
    fn is_traceable(&self) -> bool {
        let bar = &self.identity().bar;
        !self.is_specimen() && bar.certificate.is_some() && bar.length_u_mm.is_some()
    }

    pub fn robot(&self) -> &str {
        &self.result.robot
    }

    fn title(&self) -> String {
        format!("Calibration certificate of {}", self.result.robot)
    }

    fn measured(&self) -> &str {
        self.identity().measured.as_deref().unwrap_or("not stated")
    }

    /// Findings about missing data of the certificate, and warnings about it.
    pub fn findings(&self) -> Vec<CertificateFinding> {
        let Identity { robot, laboratory, country, operator, customer, measured, bar, temperatures, .. } =
            self.identity();
        let bar_by = [&bar.certificate, &bar.certified_on, &bar.certified_by];
        let lacks = [
            ("date of measurement", measured.is_none()),
            ("serial number of the robot", robot.is_none()),
            ("laboratory", laboratory.is_none()),
            ("country", country.is_none()),
            ("operator", operator.is_none()),
            ("customer", customer.is_none()),
            ("certificate of the bar", bar_by.iter().any(|text| text.is_none()) || bar.length_u_mm.is_none()),
            ("temperatures", temperatures.is_empty()),
        ];
        let lacking: Vec<&str> = lacks.iter().filter(|(_, lacks)| *lacks).map(|(name, _)| *name).collect();
        let empty = (!lacking.is_empty()).then(|| NotStated { what: Names::of(lacking) });
        let is_warning = |found: &&RecordedFinding| found.severity() == Severity::Warning;
        let of_check = self.check.iter().flat_map(|check| &check.findings).filter(is_warning).count();
        let warnings = self.result.warnings().count() + usize::from(!self.result.converged) + of_check;
        let is_ball = |found: &&ParameterResult| matches!(found.name, ParamId::Ball(_, Coordinate::X));
        let balls = self.result.parameters.iter().filter(is_ball).count();
        let other =
            self.identity().balls.keys().find(|ball| ball.parse().is_ok_and(|ball: usize| ball > balls));
        let other = other.map(|ball| NoSuchBall { ball: ball.clone(), balls });
        let with_warnings = (warnings > 0).then_some(WithWarnings { warnings });
        empty
            .into_iter()
            .chain(self.contradictions.iter().cloned())
            .chain(other)
            .chain(with_warnings)
            .collect()
    }

    pub fn html(&self) -> Result<String, Diagnostic> {
        let page = Page {
            title: self.title(),
            draft: self.draft(),
            is_specimen: self.is_specimen(),
            robot: &self.result.robot,
            number: self.number(),
            measured: self.measured(),
            sections: self.sections(),
            provenance: &self.provenance,
        };
        render("certificate.html", include_str!("../certificate.html"), &page)
    }

    pub fn dcc(&self) -> Result<Vec<u8>, Diagnostic> {
        dcc::write(self)
    }

    /// `certificate.pdf` with `dcc.xml` embedded; `None` without the feature `pdf`. Fails on a character that its font lacks.
    #[cfg(feature = "pdf")]
    pub fn pdf(&self, dcc: &[u8]) -> Result<Option<Vec<u8>>, Diagnostic> {
        Ok(Some(pdf::write(self, dcc)?))
    }

    /// Returns `None`: this build has no PDF.
    #[cfg(not(feature = "pdf"))]
    pub fn pdf(&self, _: &[u8]) -> Result<Option<Vec<u8>>, Diagnostic> {
        Ok(None)
    }
}
