//! The poses of a run that have no length yet, or that are measured again.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::files;
use crate::plan::{PlanFinding, PoseKind, is_same_planned_pose};
use crate::recording::run;
use crate::request::identify::LENGTHS;
use crate::request::identify::tables::{lengths, measurements};
use crate::request::{RequestSession, RowIndices};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::measurement::Measurement;
use dbbd_model::robot::{AXES, BallId};

/// The rows of a plan or a table that are measured again.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RepeatedRows {
    #[default]
    All,
    /// The outliers of a result.
    Outliers,
    /// The rows with these indices.
    Indices(RowIndices),
}

impl FromStr for RepeatedRows {
    type Err = String;

    /// Reads `outliers`, or indices such as `3,7-9`.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "outliers" {
            return Ok(Self::Outliers);
        }
        let indices = text.parse().map_err(|why| format!("{why}, nor `outliers`"))?;
        Ok(Self::Indices(indices))
    }
}

impl fmt::Display for RepeatedRows {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => out.write_str("all"),
            Self::Outliers => out.write_str("outliers"),
            Self::Indices(indices) => indices.fmt(out),
        }
    }
}

/// A pose of the controller: base ball and axis angles, rad.
pub(super) type GivenPose = (BallId, [f64; AXES]);

/// A pose of a run with its index.
struct RunPose {
    index: u32,
    pose: GivenPose,
}

impl RunPose {
    /// `None` for a position of a tracker, which has no ball.
    fn of(index: u32, ball: Option<BallId>, axes_deg: [f64; AXES]) -> Option<Self> {
        Some(Self { index, pose: (ball?, axes_deg.map(f64::to_radians)) })
    }
}

/// The poses of the plans of these captures that have no length in any of the captures.
pub(super) fn remaining<'a>(
    runs: impl Iterator<Item = &'a Path>,
    session: &RequestSession<'_>,
) -> Result<Vec<GivenPose>, Diagnostic> {
    let (mut planned, mut measured): (Vec<GivenPose>, Vec<GivenPose>) = (Vec::new(), Vec::new());
    let is_among = |list: &[GivenPose], (ball, axes): &GivenPose| {
        list.iter().any(|(other, others)| other == ball && is_same_planned_pose(others, axes))
    };
    for path in runs {
        let (of_plan, with_length) = of_capture(path, session)?;
        for RunPose { pose, .. } in of_plan {
            if !is_among(&planned, &pose) {
                planned.push(pose);
            }
        }
        measured.extend(with_length.into_iter().map(|one| one.pose));
    }
    planned.retain(|pose| !is_among(&measured, pose));
    if planned.is_empty() { Err(PlanFinding::NothingRemains.into()) } else { Ok(planned) }
}

/// The poses of the capture's plan that are to be measured, and the poses among them that have a length.
fn of_capture(path: &Path, session: &RequestSession<'_>) -> Result<(Vec<RunPose>, Vec<RunPose>), Diagnostic> {
    let run = run::open_run(path, None, &[], &mut |finding| session.finding(finding))?;
    let matching = run.matching(None)?;
    let is_measured = |index: u32| matching.observations.rows.iter().any(|row| row.index == index);
    let rows = run.plan.rows.iter().filter(|row| row.kind == PoseKind::Measure && !row.is_passed());
    let poses = || {
        rows.clone()
            .map(|row| RunPose { index: row.index, pose: (row.centre, row.axes_deg.map(f64::to_radians)) })
    };
    let with_length = poses().filter(|pose| is_measured(pose.index)).collect();
    Ok((poses().collect(), with_length))
}

/// The poses of a capture, a table or a result that are measured again.
pub(super) fn repeated(
    path: &Path,
    rows: &RepeatedRows,
    session: &RequestSession<'_>,
) -> Result<Vec<GivenPose>, Diagnostic> {
    let name = path.display().to_string();
    let of_result = if path.is_dir() { Some(path.to_owned()) } else { None };
    let mut poses: Vec<RunPose> = match &of_result {
        None if run::is_capture(path)? => of_capture(path, session)?.0,
        _ => {
            let table = of_result.as_ref().map_or(path.to_owned(), |result| result.join(LENGTHS));
            let read = measurements(&table, lengths, &mut Vec::new(), session)?;
            let pose = |row: &Measurement| RunPose::of(row.index, row.datum.ball(), row.axes.degrees());
            read.rows.iter().filter_map(pose).collect()
        }
    };
    let outliers = match &of_result {
        Some(result) => {
            let file = result.join("result.json");
            let result =
                CalibrationResult::from_json(&file.display().to_string(), &files::read_text(&file)?)?;
            // The table of a result has only what was used.
            let excluded = result.excluded.iter();
            poses.extend(excluded.filter_map(|row| RunPose::of(row.index, row.ball, row.axes_deg)));
            let outliers = result.outliers.iter();
            let outliers: Vec<RunPose> =
                outliers.filter_map(|row| RunPose::of(row.index, row.ball, row.axes_deg)).collect();
            let indices: Vec<u32> = outliers.iter().map(|pose| pose.index).collect();
            poses.extend(outliers);
            Some(indices)
        }
        None => None,
    };
    let wanted: Vec<u32> = match (rows, outliers) {
        (RepeatedRows::All, _) => poses.iter().map(|pose| pose.index).collect(),
        (RepeatedRows::Indices(indices), _) => indices.iter().collect(),
        (RepeatedRows::Outliers, Some(outliers)) => outliers,
        (RepeatedRows::Outliers, None) => {
            return Err(Diagnostic::file(&name, PlanFinding::OutliersWithoutResult));
        }
    };
    let mut again: Vec<GivenPose> = Vec::new();
    for index in wanted {
        let Some(found) = poses.iter().find(|pose| pose.index == index) else {
            return Err(Diagnostic::file(&name, PlanFinding::NoSuchRow { index }));
        };
        again.push(found.pose);
    }
    if again.is_empty() { Err(Diagnostic::file(&name, PlanFinding::NothingRemains)) } else { Ok(again) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_indices_and_ranges() {
        assert_eq!("3,7-9".parse(), Ok(RepeatedRows::Indices([3, 7, 8, 9].into_iter().collect())));
        assert_eq!("outliers".parse(), Ok(RepeatedRows::Outliers));
        for wrong in ["", "a", "9-7", "1,,2", "1-999999999"] {
            assert!(wrong.parse::<RepeatedRows>().is_err(), "{wrong}");
        }
    }
}
