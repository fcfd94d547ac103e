//! Zero errors of the joints as mastering offsets, in the controller's degrees and sense.
//!
//! A joint turns by theta = sign A + offset. If the identified offset exceeds the nominal one by delta, an axis for which the
//! controller shows A is at A + sign delta. For a coupled joint this is the offset of its own angle, which its drive turns.

use serde::Serialize;

use dbbd_model::base::FileFinding::Unwritable;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CompletedCalibration;
use dbbd_model::estimation::result::{ParameterResult, Status};
use dbbd_model::robot::{Joint, ParamId};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisOffset {
    /// From 1.
    pub axis: usize,
    /// True angle minus the controller's, degrees; 0 if nothing is known of it.
    pub offset_deg: f64,
    pub sd_deg: Option<f64>,
    /// Of the joint's theta: by the data alone only if this is `Identified`.
    pub status: Status,
    pub remark: String,
}

pub fn offsets(calibration: &CompletedCalibration) -> Vec<AxisOffset> {
    Joint::ALL
        .into_iter()
        .filter_map(|joint| {
            let found = calibration.result.parameter(ParamId::Theta(joint))?;
            let sign = calibration.robot.geometry.rows.get(joint.index())?.sign;
            // With the prior's help the most probable angle is known too; its standard deviation says how well.
            let is_known = matches!(found.status, Status::Identified | Status::SupportedByPrior);
            Some(AxisOffset {
                axis: joint.number(),
                offset_deg: if is_known { sign * found.correction.to_degrees() } else { 0.0 },
                sd_deg: found.sd.filter(|_| is_known).map(f64::to_degrees),
                status: found.status,
                remark: match calibration.robot.geometry.coupling.of(joint) {
                    Some(by) => format!("{}; of the joint, at A{}{by}", remark(found), joint.number()),
                    None => remark(found),
                },
            })
        })
        .collect()
}

/// A remark on a parameter's value by itself.
pub(super) fn remark(found: &ParameterResult) -> String {
    let reason = &found.reason;
    match found.status {
        Status::Identified if reason.is_empty() => "identified".into(),
        Status::Identified => format!("identified, represents others as well: {reason}"),
        Status::SupportedByPrior => format!("not identified by the data alone: {reason}"),
        Status::PoorlyObservable | Status::Dependent | Status::Fixed => format!("not identified: {reason}"),
    }
}

/// `mastering.csv`: `axis,offset_deg,sd_deg,identified,status,remark`.
pub fn csv(offsets: &[AxisOffset]) -> Result<Vec<u8>, Diagnostic> {
    let write = || {
        let mut table = csv::Writer::from_writer(Vec::new());
        table.write_record(["axis", "offset_deg", "sd_deg", "identified", "status", "remark"])?;
        for AxisOffset { axis, offset_deg, sd_deg, status, remark } in offsets {
            let identified = if *status == Status::Identified { "yes" } else { "no" };
            table.serialize((format!("A{axis}"), offset_deg, sd_deg, identified, status, remark))?;
        }
        table.into_inner().map_err(|error| csv::Error::from(error.into_error()))
    };
    write().map_err(|error| Diagnostic::file("mastering.csv", Unwritable { why: error.to_string() }))
}
