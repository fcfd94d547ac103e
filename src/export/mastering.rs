//! The joints' zero errors as mastering offsets, in the controller's degrees and sense.
//!
//! A joint turns by theta = sign A + offset. Where the identified offset is larger than the nominal one by delta, the
//! axis that shows A stands at A + sign delta.

use crate::identify::result::{Identification, ParameterResult, Status};
use crate::model::{AXES, Robot};

/// The zero error of one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisOffset {
    /// Axis, from 1.
    pub axis: usize,
    /// Where the axis truly stands minus what the controller shows, degrees; 0 where it is not told.
    pub offset_deg: f64,
    /// One standard deviation, degrees.
    pub sd_deg: Option<f64>,
    /// What became of the parameter.
    pub status: Status,
    /// Whether the number means something by itself.
    pub told: bool,
    /// What to know of it, in words.
    pub remark: String,
}

/// The offsets of the six axes.
pub fn offsets(robot: &Robot, result: &Identification) -> Vec<AxisOffset> {
    (1..=AXES)
        .filter_map(|axis| {
            let name = format!("theta{axis}");
            let found = result.parameters.iter().find(|parameter| parameter.name == name)?;
            let sign = robot.geometry.rows.get(axis - 1)?.sign;
            let (told, remark) = remark(found);
            Some(AxisOffset {
                axis,
                offset_deg: if told { sign * found.correction.to_degrees() } else { 0.0 },
                sd_deg: found.sd.filter(|_| told).map(f64::to_degrees),
                status: found.status,
                told,
                remark,
            })
        })
        .collect()
}

/// Whether a parameter's value means something by itself, and what to know of it.
pub(super) fn remark(found: &ParameterResult) -> (bool, String) {
    match found.status {
        Status::Identified if found.reason.is_empty() => (true, "told by the data".into()),
        Status::Identified => (true, format!("stands for others as well: {}", found.reason)),
        Status::Prior => (false, format!("not told by the data: {}", found.reason)),
        Status::Dependent | Status::Held | Status::TooWeak => (false, format!("not told: {}", found.reason)),
    }
}

/// `mastering.csv`: `axis,offset_deg,sd_deg,told,status,remark`.
///
/// # Errors
/// Only what the CSV writer has to say.
pub fn csv(offsets: &[AxisOffset]) -> Result<Vec<u8>, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(["axis", "offset_deg", "sd_deg", "told", "status", "remark"])?;
    for offset in offsets {
        table.serialize((
            format!("A{}", offset.axis),
            offset.offset_deg,
            offset.sd_deg,
            if offset.told { "yes" } else { "no" },
            offset.status,
            &offset.remark,
        ))?;
    }
    table.into_inner().map_err(|error| csv::Error::from(error.into_error()))
}
