//! `plan.html` from a plan: what the page needs is picked out here, and drawn by the report room.

use nalgebra::Matrix6;

use crate::cli::identify::error_maps;
use crate::identify::result::{PredictedError, PredictedPair, Status, Warning, WarningKind};
use crate::model::Robot;
use crate::plan::job::{CircleTable, Direction, Orientation};
use crate::plan::prediction::{Error3d, Fate, PredictedParameter};
use crate::plan::{Check, Kind, Plan, PlanRow};

use crate::report::{
    self, CheckRow, CircleRow, Fact, PlanView, PredictedRow, Provenance, ReportError, Source,
};

/// Poses at which the robot is drawn.
const SKELETONS: usize = 8;

/// The page of a plan made for `robot` from the job file `job`.
pub(super) fn html(
    plan: &Plan,
    robot: &Robot,
    job: &str,
    map: &[([f64; 3], f64)],
) -> Result<String, ReportError> {
    let header = &plan.header;
    let bar = &header.job.bar;
    let view = PlanView {
        margin_mm: bar.margin_mm,
        centres: header.job.centres.iter().map(|centre| (centre.id, centre.xyz_mm)).collect(),
        skeletons: skeletons(plan, robot),
        limits_deg: robot.limits_deg,
        circles: header
            .job
            .circles
            .iter()
            .enumerate()
            .map(|(at, circle)| row(at, circle, bar.length_mm))
            .collect(),
        checks: header.checks.iter().map(check).collect(),
        facts: vec![Fact::new("Duration", format!("{:.1} min at full override", plan.duration_s() / 60.0))],
        provenance: Provenance {
            dbbd_version: env!("CARGO_PKG_VERSION").into(),
            robot: robot.name.clone(),
            plan_hash: Some(header.hash.clone()),
            date: None,
            sources: vec![Source { role: "job".into(), name: job.into(), hash: None }],
        },
        predicted_error_mm: header
            .predictions
            .as_ref()
            .map(|p| PredictedPair { nominal: error(&p.now_mm), identified: error(&p.identified_mm) }),
        predicted: header.predictions.iter().flat_map(|p| &p.parameters).map(predicted).collect(),
        dependent: header.predictions.iter().flat_map(|p| p.dependent.clone()).collect(),
        maps: error_maps(map),
        against: header.predictions.iter().flat_map(|p| p.against.iter().cloned()).collect(),
        regions: header.predictions.iter().flat_map(|p| p.regions.iter().copied()).collect(),
        advice: header.predictions.iter().flat_map(|p| p.advice.clone()).collect(),
        manipulability: plan.rows.iter().map(|row| manipulability(robot, row)).collect(),
        warnings: header
            .notes
            .iter()
            .map(|text| Warning { kind: WarningKind::Note, text: text.clone() })
            .collect(),
    };
    report::plan::html(plan, &view)
}

/// Yoshikawa's measure at a row: the size of the determinant of the arm's Jacobian, m^3.
fn manipulability(robot: &Robot, row: &PlanRow) -> f64 {
    let columns = robot.geometry.axis_jacobian(&row.axes_deg.map(f64::to_radians));
    let jacobian = Matrix6::from_fn(|at, axis| {
        let (moved, turned) = &columns[axis];
        if at < 3 { moved[at] * 1e-3 } else { turned[at - 3] }
    });
    jacobian.determinant().abs()
}

fn error(error: &Error3d) -> PredictedError {
    PredictedError { mean: error.mean, p95: error.p95, max: error.max }
}

fn predicted(parameter: &PredictedParameter) -> PredictedRow {
    let (status, reason) = match parameter.fate {
        Fate::Identified => (Status::Identified, String::new()),
        Fate::TooWeak => {
            (Status::Prior, "the lengths alone leave more than 3 tolerances; the prior carries it".into())
        }
        Fate::Dependent => (Status::Dependent, "told only in a combination".into()),
        Fate::Unseen => (Status::Held, "changes no length in these poses".into()),
    };
    PredictedRow {
        name: parameter.name.clone(),
        unit: parameter.unit.clone(),
        tolerance: Some(parameter.before),
        sd: Some(parameter.sd),
        status,
        reason,
    }
}

/// The robot as lines at a few of the poses.
fn skeletons(plan: &Plan, robot: &Robot) -> Vec<Vec<[f64; 3]>> {
    let measured: Vec<_> = plan.rows.iter().filter(|row| row.kind == Kind::Measure).collect();
    measured
        .iter()
        .step_by(measured.len().div_ceil(SKELETONS).max(1))
        .map(|row| {
            let axes = row.axes_deg.map(f64::to_radians);
            let mut line: Vec<[f64; 3]> = vec![[0.0; 3]];
            line.extend(robot.geometry.skeleton(&axes).iter().map(|joint| <[f64; 3]>::from(*joint)));
            line.push(robot.geometry.ball(&axes).position.into());
            line
        })
        .collect()
}

fn row(at: usize, circle: &CircleTable, bar_mm: f64) -> CircleRow {
    let plane = match (circle.plane, circle.normal) {
        (Some(plane), _) => format!("{plane:?}").to_uppercase(),
        (None, Some([x, y, z])) => format!("normal ({x}, {y}, {z})"),
        (None, None) => String::new(),
    };
    CircleRow {
        number: at as u32 + 1,
        centre: circle.centre,
        plane,
        radius_mm: circle.radius_mm.unwrap_or(bar_mm),
        points: circle.points as usize,
        direction: match circle.direction {
            Direction::Ccw => "counter-clockwise",
            Direction::Cw => "clockwise",
            Direction::Both => "both",
        }
        .into(),
        orientation: match circle.orientation {
            Orientation::Fixed => "fixed",
            Orientation::Seed => "seed",
            Orientation::Random => "random",
            Orientation::Turning => "turning",
            Orientation::Optimal => "optimal",
        }
        .into(),
        mode: "dwell".into(),
    }
}

fn check(check: &Check) -> CheckRow {
    let bound = if check.quantity.at_least() { "at least" } else { "at most" };
    CheckRow {
        quantity: check.quantity.words().0.into(),
        worst: check.quantity.shown(check.worst),
        limit: format!("{bound} {}", check.quantity.shown(check.limit)),
        place: format!("row {}", check.row),
        passed: check.holds(),
    }
}
