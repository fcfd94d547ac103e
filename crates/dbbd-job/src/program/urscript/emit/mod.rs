//! Emits the script of a plan: one program with a routine for each circle.
//!
//! A routine does the same as a module of KRL (see [`crate::program::krl::emit`]), with the strobe on a standard output and
//! the index on the configurable outputs. Poses are in metres with a rotation vector, in the robot base: the language has no
//! base frame. A motion without blend ends before the robot is at rest, so a dwell waits for `is_steady()`. Lines and
//! joint motions have a duration, which takes precedence over speed and acceleration; arcs cannot have a duration.

use minijinja::context;
use minijinja::value::{Serde, Value};

use crate::plan::Plan;
use crate::plan::timing::ACCELERATION_MM_S2;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::emission::{
    Sync, Templates, Written, module_variables, name, plan_variables, refuse_krl_only,
};
use crate::program::sequence::{Timed, modules};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{ControllerFrames, ControllerModel, Pose, Robot};

const TEMPLATES: [(&str, &str); 1] = [("program.script", include_str!("program.script"))];
/// Number of standard outputs, which are numbered from 0.
const OUTPUTS: u32 = 8;

/// The script of a plan (ASCII, CR LF).
pub fn emit(plan: &Plan, sync: Sync) -> Result<Written, Diagnostic> {
    refuse_krl_only(plan, Language::Urscript, sync)?;
    let output = plan.header.job.motion.outputs.strobe;
    if sync == Sync::Output && output >= OUTPUTS {
        return Err(ProgramFinding::OutputNumber { output }.into());
    }
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let controller = robot.controller();
    let mut routines = Vec::new();
    for (module, number) in modules(plan)?.iter().zip(1..) {
        routines.push(context! {
            name => name(number),
            start_rad => Serde(module.start.row.axes_deg.map(f64::to_radians)),
            points => module.rows.iter().map(|timed| point_variables(timed, &controller.frames)).collect::<Value>(),
            ..module_variables(plan, module)?
        });
    }
    let ball = Pose { position: controller.geometry.tool, ..Pose::identity() };
    let tool = controller.frames.flange.inverse().then(&ball);
    let payload = controller.geometry.load.carried().map(|payload| {
        let centre: [f64; 3] = (payload.centre * 1e-3).into();
        context! { kg => payload.kg, centre => Serde(centre) }
    });
    let plan = context! {
        tool => metres(&tool),
        payload => payload,
        // A controller with its own kinematic table moves a Cartesian target to another place: a short joint motion
        // ends at the planned axes.
        to_axes => controller.controller_model == ControllerModel::Unknown,
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        ..plan_variables(plan, Language::Urscript, sync)?
    };
    let context = context! { plan => plan, modules => Value::from(routines) };
    let script = Templates::new(&TEMPLATES)?.render("program.script", &context)?;
    Ok(vec![("DBB_MAIN.script".into(), script)])
}

/// A position in metres and a rotation vector.
fn metres(pose: &Pose) -> Value {
    let (place, turn) = (pose.position * 1e-3, rotation_vector(&pose.rotation));
    Serde([place.x, place.y, place.z, turn.x, turn.y, turn.z]).into()
}

fn point_variables(timed: &Timed<'_>, frames: &ControllerFrames) -> Value {
    let Timed { row, time, .. } = timed;
    context! {
        axes => Serde(row.axes_deg.map(f64::to_radians)),
        pose => metres(&frames.base.then(&Pose::from_kuka(row.xyz_mm, row.abc_deg))),
        feed_mm_s => time.feed_mm_s,
    }
}
