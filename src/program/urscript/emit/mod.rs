//! Writes the script of a plan: one routine for each circle, inside one program that calls them.
//!
//! A routine does what a module of KRL does (see [`crate::program::krl::emit`]), with the strobe on a standard output and
//! the index on the configurable ones. Poses are in metres with a rotation vector, in the robot's base: the language has
//! no base frame. A motion without blend ends before the robot is at rest, so that dwells wait for `is_steady()`. Lines
//! and motions of the joints are given their time, which has precedence over speed and acceleration; arcs have none.

use minijinja::context;
use minijinja::value::{Serde, Value};

use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::Plan;
use crate::plan::timing::ACCELERATION_MM_S2;
use crate::program::Language;
use crate::program::emission::{Sync, Templates, Written, module_text, name, only_stops, payload, plan_text};
use crate::program::sequence::{Timed, modules};
use crate::robot::pose::rotation_vector;
use crate::robot::{Pose, Robot};

const TEMPLATES: [(&str, &str); 1] = [("program.script", include_str!("program.script"))];
/// Standard outputs, from 0.
const OUTPUTS: u32 = 8;

/// The script of a plan (ASCII, CR LF).
pub fn emit(plan: &Plan, sync: Sync) -> Result<Written, Diagnostic> {
    only_stops(plan, Language::Urscript, sync)?;
    let output = plan.header.job.motion.outputs.strobe;
    if sync == Sync::Output && output >= OUTPUTS {
        return Err(ProgramFinding::OutputNumber { output }.into());
    }
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let mut texts = Vec::new();
    for (module, number) in modules(plan)?.iter().zip(1..) {
        texts.push(context! {
            name => name(number),
            start_rad => Serde(module.start.row.axes_deg.map(f64::to_radians)),
            points => module.rows.iter().map(point_text).collect::<Value>(),
            ..module_text(plan, module)?
        });
    }
    let controller = robot.controller();
    let tool = Pose { position: controller.geometry.tool, ..Pose::identity() };
    let payload = payload(controller).map(|mass| {
        let centre: [f64; 3] = (mass.centre * 1e-3).into();
        context! { kg => mass.kg, centre => Serde(centre) }
    });
    let plan = context! {
        tool => pose_text(&tool),
        payload => payload,
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        ..plan_text(plan, Language::Urscript, sync)?
    };
    let context = context! { plan => plan, modules => Value::from(texts) };
    let script = Templates::new(&TEMPLATES)?.fill("program.script", &context)?;
    Ok(vec![("DBB_MAIN.script".into(), script)])
}

/// Metres and a rotation vector.
fn pose_text(pose: &Pose) -> Value {
    let (place, turn) = (pose.position * 1e-3, rotation_vector(&pose.rotation));
    Serde([place.x, place.y, place.z, turn.x, turn.y, turn.z]).into()
}

fn point_text(timed: &Timed<'_>) -> Value {
    let Timed { row, time, .. } = timed;
    context! {
        axes => Serde(row.axes_deg.map(f64::to_radians)),
        pose => pose_text(&Pose::from_kuka(row.xyz_mm, row.abc_deg)),
        feed_mm_s => time.feed_mm_s,
    }
}
