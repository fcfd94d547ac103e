//! The contents of a certificate in the order of its sections (ISO/IEC 17025 7.8).

use serde::Serialize;

use super::{Certificate, Check};
use crate::report::parameters::not_estimated;
use crate::report::scale::{decimals, fixed, signed, significant, typeset};
use crate::report::verdict::Verdict;
use dbbd_model::conformity::BudgetLine;
use dbbd_model::diagnostic::{Names, RecordedFinding};
use dbbd_model::estimation::result::{ExcludedMeasurement, ParameterResult, Status};
use dbbd_model::robot::ParamUnit;

#[derive(Serialize)]
pub(super) struct Section {
    pub(super) title: &'static str,
    pub(super) blocks: Vec<Block>,
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Block {
    Text(String),
    Facts(Vec<Fact>),
    Table(Table),
    /// Lines to sign on.
    Signatures(Vec<&'static str>),
}

/// Name and value.
type Fact = (String, String);

#[derive(Serialize)]
pub(super) struct Table {
    pub(super) head: Vec<Head>,
    pub(super) rows: Vec<Vec<String>>,
    /// Whether the last row is the sum.
    pub(super) sum: bool,
}

#[derive(Clone, Copy, Serialize)]
pub(super) struct Head {
    pub(super) title: &'static str,
    pub(super) number: bool,
}

const fn text(title: &'static str) -> Head {
    Head { title, number: false }
}

const fn number(title: &'static str) -> Head {
    Head { title, number: true }
}

fn fact(name: &str, value: impl Into<String>) -> Fact {
    (name.to_owned(), value.into())
}

fn mm(value: f64) -> String {
    format!("{} mm", significant(value, 3))
}

/// A number or a dash.
fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "–".to_owned())
}

/// Quantities that lengths to base balls never determine.
pub(super) const NEVER_DETERMINED: [&str; 4] = [
    "Position and orientation of the robot base in the cell: lengths do not change when robot and balls are moved together. The position uncertainty is after the best rigid alignment.",
    "The orientation of the tool: the tool ball is a point.",
    "Behaviour at other temperatures, loads and speeds than those of the measurement, and the drift since.",
    "Pose accuracy by ISO 9283, which needs the base frame.",
];

pub(super) const METHOD: &str = "Lengths between base balls and the tool ball were measured with a telescoping double ball-bar at many poses of the robot, each with the axis angles of the controller. The kinematic parameters were estimated by weighted least squares with the uncertainty of each (GUM, JCGM 100). The position uncertainty is predicted over axis angles uniform within the limits of the axes.";

impl Certificate {
    pub(super) fn sections(&self) -> Vec<Section> {
        let section = |title, blocks| Section { title, blocks };
        vec![
            section("Statement", self.statement()),
            section("Object and order", vec![Block::Facts(self.object())]),
            section("Method", vec![Block::Text(METHOD.into())]),
            section("Equipment, traceability and conditions", self.traceability()),
            section("Results", vec![Block::Facts(self.results())]),
            section("Uncertainty budget", self.budget_blocks()),
            section("Conformity", self.conformity()),
            section("What was not determined", self.not_determined()),
            section("Identified parameters", self.parameters()),
            section("Warnings and notes of the result and the check", self.findings_of_result()),
            section("Signatures", self.signatures()),
        ]
    }

    /// The verdict in the words of the report.
    fn statement(&self) -> Vec<Block> {
        let verdict = Verdict::of_calibration(&self.result, &self.budget, &self.standing());
        vec![Block::Text(verdict.statement())]
    }

    fn object(&self) -> Vec<Fact> {
        let identity = self.identity();
        let stated = |text: &Option<String>| text.clone().unwrap_or_else(|| "not stated".into());
        let mut facts = vec![
            fact("Number of the draft", self.number()),
            fact("Robot", &self.result.robot),
            fact("Serial number", stated(&identity.robot)),
            fact("Serial number of the controller", stated(&identity.controller)),
            fact("Customer", stated(&identity.customer)),
            fact("Laboratory", stated(&identity.laboratory)),
            fact("Cell", stated(&identity.cell)),
            fact("Operator", stated(&identity.operator)),
            fact("Date of measurement", self.measured()),
            fact("Date of issue", ""),
        ];
        facts.extend(identity.load_kg.map(|kg| fact("Load at the flange", format!("{kg} kg"))));
        facts
    }

    fn traceability(&self) -> Vec<Block> {
        let statement = if self.is_specimen() {
            "A specimen states no traceability."
        } else if self.is_traceable() {
            "The lengths are traceable to the SI through the certificate of the bar's length."
        } else {
            "The lengths are not traceable to the SI: the certificate of the bar, or the uncertainty of its length, is not stated."
        };
        let of_object =
            ["robot", "controller", "laboratory", "operator", "customer", "cell", "measured", "country"];
        let kept =
            |name: &str| !of_object.iter().any(|word| name.ends_with(word)) && !name.starts_with("load");
        let facts: Vec<_> = self.identity().facts().into_iter().filter(|(name, _)| kept(name)).collect();
        let mut blocks = vec![Block::Text(statement.into())];
        if !facts.is_empty() {
            blocks.push(Block::Facts(facts));
        }
        blocks
    }

    fn results(&self) -> Vec<Fact> {
        let result = &self.result;
        let (residual, predicted) = (&result.residual_mm, &result.predicted_position_uncertainty_mm);
        let (nominal, identified) = (&predicted.nominal, &predicted.identified);
        let pair = |name: &str, before: f64, after: f64| {
            fact(name, format!("{} before, {} after", mm(before), mm(after)))
        };
        let mut used =
            format!("{} used, {} excluded as outliers", result.measurements, result.outliers.len());
        if !result.excluded.is_empty() {
            used.push_str(&format!(", {} on request", result.excluded.len()));
        }
        let mut facts = vec![
            fact("Lengths", used),
            fact("Standard deviation of a length", mm(result.noise_mm.length)),
            pair("Residual of the lengths, rms", residual.before.rms, residual.after.rms),
        ];
        let held_out = "Held-out residual by cross-validation, rms";
        facts.extend(result.folds.map(|folds| fact(held_out, mm(folds.rms))));
        facts.extend(result.validation.map(|separate| {
            pair("Residual of separate lengths, rms", separate.before.rms, separate.after.rms)
        }));
        facts.extend(result.excluded.iter().map(left_out));
        facts.push(pair("Position uncertainty, mean", nominal.mean, identified.mean));
        facts.push(pair("Position uncertainty, 95 % of the poses", nominal.p95, identified.p95));
        facts.extend(result.predicted_orientation_uncertainty_mrad.iter().map(|turned| {
            let [before, after] =
                [turned.nominal.mean, turned.identified.mean].map(|mrad| significant(mrad, 2));
            fact(
                "Orientation uncertainty of the flange, mean",
                format!("{before} mrad before, {after} mrad after"),
            )
        }));
        let (k, expanded) = (self.budget.coverage_factor, self.budget.expanded_mm);
        facts.push(fact("Expanded position uncertainty", format!("U = {} (k = {k})", mm(expanded))));
        facts
    }

    fn budget_blocks(&self) -> Vec<Block> {
        let budget = &self.budget;
        let um = |mm: Option<f64>| or_dash(mm.map(|mm| significant(1e3 * mm, 3)));
        let share = |mm: f64| 100.0 * (mm / budget.combined_mm).powi(2);
        let row = |line: &BudgetLine| {
            let share = line.position_mm.map(share).filter(|share| share.is_finite());
            let share = or_dash(share.map(|share| fixed(share, 1)));
            let (source, basis) = (line.source.words().to_owned(), line.basis.words().to_owned());
            vec![source, basis, um(line.length_mm), um(line.position_mm), share]
        };
        let mut rows: Vec<Vec<String>> = budget.lines.iter().map(row).collect();
        let (k, combined) = (budget.coverage_factor, budget.combined_mm);
        rows.push(vec![
            format!("combined; expanded U = {} µm (k = {k})", um(Some(budget.expanded_mm))),
            String::new(),
            String::new(),
            um(Some(combined)),
            fixed(100.0, 1),
        ]);
        let head = vec![
            text("Source"),
            text("Basis"),
            number("of a length (µm)"),
            number("of the position (µm)"),
            number("share (%)"),
        ];
        let about = "Standard uncertainties of the tool ball's position over the workspace: the root mean square of the 3-D error that each source alone leaves. The sources are independent; what is not determined is not in the sum. A normal 3-D error exceeds twice the combined one with a probability of at most 4.6 %.";
        vec![Block::Table(Table { head, rows, sum: true }), Block::Text(about.into())]
    }

    fn conformity(&self) -> Vec<Block> {
        let none = "No decision: no tolerance was stated. The results are no statement of conformity.";
        vec![self.check.as_ref().map_or(Block::Text(none.into()), |check| Block::Facts(decision(check)))]
    }

    fn not_determined(&self) -> Vec<Block> {
        let lines = not_estimated(&self.result.parameters);
        let mut blocks: Vec<Block> =
            NEVER_DETERMINED.iter().map(|line| Block::Text((*line).into())).collect();
        if !lines.is_empty() {
            let rows = lines
                .iter()
                .map(|line| vec![Names::of(&line.names).to_string(), typeset(line.reason.to_owned())]);
            let head = vec![text("Parameters that keep their start values"), text("Why")];
            blocks.push(Block::Table(Table { head, rows: rows.collect(), sum: false }));
        }
        blocks
    }

    fn parameters(&self) -> Vec<Block> {
        let estimated =
            |p: &&ParameterResult| matches!(p.status, Status::Identified | Status::SupportedByPrior);
        let rows: Vec<_> = self.result.parameters.iter().filter(estimated).map(parameter_row).collect();
        let head = vec![
            text("Parameter"),
            text("unit"),
            number("nominal"),
            number("identified"),
            number("correction"),
            number("U (k = 2)"),
            text("determined by"),
        ];
        let combined = self.result.combinations.iter().map(|group| Block::Text(typeset(group.to_string())));
        [Block::Table(Table { head, rows, sum: false })].into_iter().chain(combined).collect()
    }

    fn findings_of_result(&self) -> Vec<Block> {
        let line = |finding: &RecordedFinding| {
            Block::Text(format!("{} {}", finding.code(), typeset(finding.text())))
        };
        let of_check = self.check.iter().flat_map(|check| &check.findings);
        let mut blocks: Vec<Block> = self.result.findings.iter().chain(of_check).map(line).collect();
        if !self.result.converged {
            blocks.insert(0, Block::Text("The solver did not converge.".into()));
        }
        if blocks.is_empty() {
            blocks.push(Block::Text("None.".into()));
        }
        blocks
    }

    fn signatures(&self) -> Vec<Block> {
        let by = format!("Made by dbbd {} from result.json {}.", self.provenance.dbbd, self.number());
        if self.is_specimen() {
            return vec![Block::Text(format!("{}: nobody signs it.", self.draft()))];
        }
        let draft = format!(
            "{}. A laboratory that issues it takes responsibility for it by its signature.",
            self.draft()
        );
        vec![
            Block::Text(format!("{draft} {by}")),
            Block::Signatures(vec!["Performed by, date", "Approved by, date"]),
        ]
    }
}

/// The person who left out a length, and the reason.
fn left_out(excluded: &ExcludedMeasurement) -> Fact {
    let stated = |text: &Option<String>| text.clone().unwrap_or_else(|| "not stated".into());
    let ExcludedMeasurement { index, residual_mm, by, reason, .. } = excluded;
    let about = format!("residual {}; by {}: {}", mm(*residual_mm), stated(by), stated(reason));
    fact(&format!("Left out on request: row {index}"), about)
}

/// The decision with its rule.
fn decision(check: &Check) -> Vec<Fact> {
    let rule = match check.rule.as_str() {
        "guard_band" => {
            "guard band (JCGM 106:2012, 8.3): pass or fail only if the probability of the contrary is at most the risk"
        }
        "simple_acceptance" => {
            "simple acceptance (JCGM 106:2012, 8.2): by the most probable value alone, shared risk"
        }
        "change" => {
            "no tolerance is stated: neither pass nor fail, but unchanged or changed since the calibration"
        }
        other => other,
    };
    let mut facts = vec![
        fact("Decision", &check.decision),
        fact("Rule", rule),
        fact("By", format!("an interim check with {} lengths", check.lengths)),
    ];
    facts.extend(check.tolerance_mm.map(|tolerance| fact("Tolerance, 95 % of the poses", mm(tolerance))));
    facts.push(fact("Position error, 95 % of the poses", mm(check.position_error_mm)));
    facts.push(fact("Its upper limit", mm(check.upper_mm)));
    facts.extend(check.guard_band_mm.map(|band| fact("Guard band", mm(band))));
    let risk = if check.decision == "undecided" {
        "Probability that the tolerance is exceeded"
    } else {
        "Specific risk of a wrong decision"
    };
    facts.extend(check.specific_risk.map(|value| fact(risk, significant(value, 2))));
    facts
}

/// A row of the table of parameters, in mm, degrees and µrad/Nm, with two figures of the uncertainty.
fn parameter_row(parameter: &ParameterResult) -> Vec<String> {
    let (unit, factor) = match parameter.unit {
        ParamUnit::Rad => ("deg", 180.0 / std::f64::consts::PI),
        ParamUnit::RadPerNm => ("µrad/Nm", 1e6),
        ParamUnit::Mm => ("mm", 1.0),
    };
    let has_prior = parameter.status == Status::SupportedByPrior;
    let u = parameter.sd.map(|sd| 2.0 * factor * sd).filter(|u| *u > 0.0);
    let places = u.map_or(4, |u| decimals(u) + 1);
    vec![
        parameter.name.to_string(),
        unit.to_owned(),
        fixed(factor * parameter.nominal, places),
        fixed(factor * parameter.identified, places),
        signed(factor * parameter.correction, places),
        or_dash(u.map(|u| fixed(u, places))),
        (if has_prior { "lengths and prior" } else { "lengths" }).to_owned(),
    ]
}
