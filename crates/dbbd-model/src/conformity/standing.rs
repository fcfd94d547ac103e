//! The standing of a calibration: whether it may be used on a day, and why not. Every document and every step that says so
//! asks [`standing`].

use std::fmt;

use serde::{Deserialize, Serialize};

use super::ConformityOutcome;
use crate::base::date;
use crate::diagnostic::{RecordedFinding, Severity};
use crate::estimation::{CalibrationResult, Validity};
use crate::provenance::{Provenance, ProvenanceFinding};

/// Whether a calibration may be used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "standing", rename_all = "snake_case")]
pub enum Standing {
    /// It may be used, until a day if one is known.
    Usable { until: Option<String> },
    /// It has warnings: it may be used by whoever has judged them harmless.
    Warned,
    /// Its last check decided nothing.
    Undecided,
    /// Its validity ended on a day.
    Over { until: String },
    /// Its last check failed.
    Failed,
}

/// What `result.json` states about the use of its calibration.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct StatedResult {
    #[serde(default)]
    findings: Vec<RecordedFinding>,
    #[serde(default = "converged")]
    converged: bool,
    #[serde(default)]
    validity: Option<ValidUntil>,
}

fn converged() -> bool {
    true
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct ValidUntil {
    #[serde(default)]
    until: Option<String>,
}

impl Default for StatedResult {
    /// A result that states nothing.
    fn default() -> Self {
        Self { findings: Vec::new(), converged: true, validity: None }
    }
}

impl From<&CalibrationResult> for StatedResult {
    fn from(result: &CalibrationResult) -> Self {
        let until = |validity: &Validity| ValidUntil { until: validity.until.clone() };
        Self {
            findings: result.findings.clone(),
            converged: result.converged,
            validity: result.validity.as_ref().map(until),
        }
    }
}

impl StatedResult {
    fn has_warnings(&self) -> bool {
        !self.converged || self.findings.iter().any(|finding| finding.severity() != Severity::Info)
    }

    /// The day on which the validity ends, if it is known: the day of a check that confirms the calibration is later.
    pub fn until<'a>(&'a self, check: Option<&'a StatedCheck>) -> Option<&'a str> {
        let of_check = check.and_then(|check| check.validity.as_ref()?.until.as_deref());
        of_check.or_else(|| self.validity.as_ref()?.until.as_deref())
    }
}

/// What `check.json` states about the calibration that it checked.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct StatedCheck {
    decision: ConformityOutcome,
    #[serde(default)]
    validity: Option<ValidUntil>,
    #[serde(default)]
    provenance: Provenance,
}

impl StatedCheck {
    pub fn decision(&self) -> ConformityOutcome {
        self.decision
    }

    /// Whether the robot file with this hash was checked. A check of another calibration says nothing about this one.
    pub fn is_of(&self, robot_sha256: &str) -> bool {
        self.provenance.from.iter().any(|source| source.sha256 == robot_sha256)
    }
}

/// The standing on a day, with the last check of this calibration if there is one. Without a day nothing has ended.
pub fn standing(result: &StatedResult, check: Option<&StatedCheck>, today: Option<&str>) -> Standing {
    let until = result.until(check);
    let is_over = |until: &&str| {
        let left = today.and_then(|today| date::months_between(today, until));
        left.is_some_and(|months| months < 0.0)
    };
    match (check.map(|check| check.decision.confirms()), until) {
        (Some(Some(false)), _) => Standing::Failed,
        (_, Some(until)) if is_over(&until) => Standing::Over { until: until.to_owned() },
        (Some(None), _) => Standing::Undecided,
        _ if result.has_warnings() => Standing::Warned,
        (_, until) => Standing::Usable { until: until.map(str::to_owned) },
    }
}

impl Standing {
    /// The finding about a calibration that is not to be used any more.
    pub fn finding(&self, robot: &str) -> Option<ProvenanceFinding> {
        match self {
            Self::Failed => Some(ProvenanceFinding::CheckFailed { robot: robot.into() }),
            Self::Over { until } => {
                Some(ProvenanceFinding::ValidityOver { robot: robot.into(), until: until.clone() })
            }
            Self::Usable { .. } | Self::Warned | Self::Undecided => None,
        }
    }
}

impl fmt::Display for Standing {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usable { until: Some(until) } => write!(out, "may be used until {until}"),
            Self::Usable { until: None } => out.write_str("may be used"),
            Self::Warned => out.write_str("has warnings: to be used only if they are judged harmless"),
            Self::Undecided => out.write_str("its last check decided nothing"),
            Self::Over { until } => write!(out, "its validity ended on {until}"),
            Self::Failed => out.write_str("is not to be used: its last check failed"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn result(until: Option<&str>, severity: &str) -> StatedResult {
        let found = json!({ "code": "W1085", "severity": severity, "text": "t" });
        let findings = if severity.is_empty() { json!([]) } else { json!([found]) };
        serde_json::from_value(json!({ "findings": findings, "validity": { "until": until } })).unwrap()
    }

    fn check(decision: &str, until: Option<&str>) -> StatedCheck {
        let from = json!([{ "role": "identified_robot", "name": "r", "sha256": "aa" }]);
        let validity = until.map(|until| json!({ "until": until }));
        let provenance = json!({ "dbbd": "1", "from": from });
        serde_json::from_value(
            json!({ "decision": decision, "validity": validity, "provenance": provenance }),
        )
        .unwrap()
    }

    #[test]
    fn the_last_check_decides_then_the_day_then_the_warnings() {
        let today = Some("2026-05-01T12:00:00Z");
        let of =
            |result: &StatedResult, check: Option<&StatedCheck>| standing(result, check, today).to_string();
        let sound = result(Some("2026-06-01"), "info");
        assert_eq!(of(&sound, None), "may be used until 2026-06-01");
        assert_eq!(of(&result(None, ""), None), "may be used");
        let (over, warned) = (result(Some("2026-04-30"), ""), result(Some("2026-06-01"), "warning"));
        assert_eq!(of(&over, None), "its validity ended on 2026-04-30");
        assert_eq!(standing(&over, None, None), Standing::Usable { until: Some("2026-04-30".into()) });
        assert_eq!(standing(&warned, None, today), Standing::Warned);
        for (decision, expected) in [("fail", Standing::Failed), ("changed", Standing::Failed)] {
            for result in [&sound, &over, &warned] {
                assert_eq!(standing(result, Some(&check(decision, None)), today), expected);
            }
        }
        assert_eq!(standing(&warned, Some(&check("undecided", None)), today), Standing::Undecided);
        // A check that confirms the calibration moves the end of its validity.
        let confirmed = check("pass", Some("2026-09-01"));
        assert_eq!(of(&over, Some(&confirmed)), "may be used until 2026-09-01");
        assert_eq!(standing(&warned, Some(&check("unchanged", None)), today), Standing::Warned);
        assert!(confirmed.is_of("aa") && !confirmed.is_of("ab"));
    }
}
