//! Zero errors of the joints as mastering offsets, in the controller's degrees and sense.
//!
//! A joint turns by theta = sign A + offset. If the identified offset exceeds the nominal one by delta, an axis for which the
//! controller shows A is at A + sign delta. For a coupled joint this is the offset of its own angle, which its drive turns.

use serde::Serialize;

use dbbd_model::base::FileFinding::Unwritable;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::{CalibrationResult, ParameterResult, Status};
use dbbd_model::robot::{AXES, Joint, ParamId, Payload, Robot};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisOffset {
    /// Number of the axis, from 1.
    pub axis: usize,
    /// True angle minus the controller's angle, degrees; 0 if the offset is not known.
    pub offset_deg: f64,
    pub sd_deg: Option<f64>,
    /// Status of the joint's theta. Only with `Identified` the data alone determine the offset.
    pub status: Status,
    pub remark: String,
    /// The payloads on the flange during the measurement: with another load a joint bends by another angle.
    pub payload: String,
}

/// True angle minus the controller's angle of each axis, rad, from the tables of an identified robot.
pub(super) fn zeros(robot: &Robot) -> [f64; AXES] {
    let nominal = &robot.controller().geometry;
    std::array::from_fn(|at| {
        let row = &robot.geometry.rows[at];
        row.sign * (row.theta - nominal.rows[at].theta)
    })
}

/// The payloads of the measurements: mass in kg, centre in the flange frame in mm.
fn measured_payload(robot: &Robot) -> String {
    let measured = robot.geometry.load.payloads.iter().filter(|payload| payload.is_measured);
    let shown = |Payload { name, kg, centre, .. }: &Payload| {
        let [x, y, z] = <[f64; 3]>::from(*centre);
        format!("{name}: {kg} kg at {x} {y} {z} mm")
    };
    let shown: Vec<String> = measured.map(shown).collect();
    if shown.is_empty() { "not stated".into() } else { shown.join("; ") }
}

pub fn offsets(result: &CalibrationResult, robot: &Robot) -> Vec<AxisOffset> {
    let payload = measured_payload(robot);
    Joint::ALL
        .into_iter()
        .filter_map(|joint| {
            let found = result.parameter(ParamId::Theta(joint))?;
            let sign = robot.geometry.rows.get(joint.index())?.sign;
            // With the help of the prior the most probable angle is known as well; its standard deviation states how
            // well.
            let is_known = matches!(found.status, Status::Identified | Status::SupportedByPrior);
            Some(AxisOffset {
                axis: joint.number(),
                offset_deg: if is_known { sign * found.correction.to_degrees() } else { 0.0 },
                sd_deg: found.sd.filter(|_| is_known).map(f64::to_degrees),
                status: found.status,
                remark: match robot.geometry.coupling.of(joint) {
                    Some(by) => format!("{}; of the joint, at A{}{by}", remark(found), joint.number()),
                    None => remark(found),
                },
                payload: payload.clone(),
            })
        })
        .collect()
}

/// A remark on a parameter's value, without reference to others.
pub(super) fn remark(found: &ParameterResult) -> String {
    let reason = &found.reason;
    match found.status {
        Status::Identified if reason.is_empty() => "identified".into(),
        Status::Identified => format!("identified, represents others as well: {reason}"),
        Status::SupportedByPrior => format!("not identified by the data alone: {reason}"),
        Status::PoorlyObservable | Status::Dependent | Status::Fixed => format!("not identified: {reason}"),
    }
}

/// `mastering.csv`: `axis,offset_deg,sd_deg,identified,status,payload,remark`.
pub fn csv(offsets: &[AxisOffset]) -> Result<Vec<u8>, Diagnostic> {
    let write = || {
        let mut table = csv::Writer::from_writer(Vec::new());
        table.write_record(["axis", "offset_deg", "sd_deg", "identified", "status", "payload", "remark"])?;
        for AxisOffset { axis, offset_deg, sd_deg, status, payload, remark } in offsets {
            let identified = if *status == Status::Identified { "yes" } else { "no" };
            table.serialize((format!("A{axis}"), offset_deg, sd_deg, identified, status, payload, remark))?;
        }
        table.into_inner().map_err(|error| csv::Error::from(error.into_error()))
    };
    write().map_err(|error| Diagnostic::file("mastering.csv", Unwritable { why: error.to_string() }))
}
