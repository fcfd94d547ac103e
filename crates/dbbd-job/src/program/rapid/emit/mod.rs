//! Emits the RAPID modules of a plan: one for each circle, and a main module that calls them.
//!
//! A module does the same as a module of KRL (see [`crate::program::krl::emit`]), with the signals `DBBSTB` (a digital
//! output) and `DBBIDX` (a group of eight), which the configuration of the controller must define. A dwell waits until
//! the robot is in position and at zero speed, because a motion to `fine` ends with its command, before the robot has
//! stopped. Targets of joint motions are axis angles; the other targets have the configuration (`confdata`) of the
//! plan's axis angles, and `ConfL\Off` keeps lines and arcs in the solution branch of their start.

use minijinja::context;
use minijinja::value::{Serde, Value};
use nalgebra::Vector3;

use crate::plan::timing::ACCELERATION_MM_S2;
use crate::plan::{MotionKind, Plan, PlanFrames};
use crate::program::Language;
use crate::program::emission::{
    Sync, Templates, Written, module_calls, module_variables, name, plan_variables, printed_frames,
    refuse_krl_only,
};
use crate::program::sequence::{Timed, modules};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{Payload, Pose, Robot, inverse};

const TEMPLATES: [(&str, &str); 3] = [
    ("main.mod", include_str!("main.mod")),
    ("circle.mod", include_str!("circle.mod")),
    ("program.pgf", include_str!("program.pgf")),
];

/// The modules of a plan (ASCII, CR LF) and the program file that lists them; the first is the main module.
pub fn emit(plan: &Plan, sync: Sync) -> Result<Written, Diagnostic> {
    refuse_krl_only(plan, Language::Rapid, sync)?;
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let controller = robot.controller();
    let templates = Templates::new(&TEMPLATES)?;
    let variables = variables(plan, controller, sync)?;
    let modules = modules(plan)?;
    let of_all = context! { plan => &variables, modules => module_calls(&modules) };
    let mut files = vec![
        ("DBB_MAIN.mod".into(), templates.render("main.mod", &of_all)?),
        ("DBB.pgf".into(), templates.render("program.pgf", &of_all)?),
    ];
    let frames = plan.header.job.motion.frames();
    for (module, number) in modules.iter().zip(1..) {
        let name = name(number);
        let points = module.rows.iter().map(|timed| point_variables(timed, &frames, controller));
        let context = context! {
            plan => &variables,
            name => &name,
            points => points.collect::<Value>(),
            ..module_variables(plan, module)?
        };
        files.push((format!("{name}.mod"), templates.render("circle.mod", &context)?));
    }
    Ok(files)
}

/// The variables of the plan for the templates.
fn variables(plan: &Plan, robot: &Robot, sync: Sync) -> Result<Value, Diagnostic> {
    let motion = &plan.header.job.motion;
    let [tool, base] = printed_frames(motion, robot).map(Pose::from_xyzabc);
    // A controller refuses a tool without mass.
    let least = Payload { kg: 0.001, centre: Vector3::new(0.0, 0.0, 0.001), ..Payload::default() };
    let payload = robot.geometry.load.carried().unwrap_or(&least);
    let centre: [f64; 3] = payload.centre.into();
    Ok(context! {
        tool => frame(&tool),
        base => frame(&base),
        payload => context! { kg => payload.kg, centre => Serde(centre) },
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        ..plan_variables(plan, Language::Rapid, sync)?
    })
}

fn frame(pose: &Pose) -> Value {
    let place: [f64; 3] = pose.position.into();
    context! { place => Serde(place), turn => Serde(pose.quaternion()) }
}

fn point_variables(timed: &Timed<'_>, frames: &PlanFrames, robot: &Robot) -> Value {
    let Timed { row, time, .. } = timed;
    if row.motion == MotionKind::Ptp {
        return context! { axes => Serde(row.axes_deg), speeds => false };
    }
    let (xyz_mm, abc_deg) = frames.printed(row);
    let axes = row.axes_deg.map(f64::to_radians);
    context! {
        axes => false,
        configuration => Serde(inverse::quadrants(&robot.geometry, &axes)),
        speeds => (!timed.is_auxiliary()).then(|| Value::from_iter([time.feed_mm_s, time.turn_deg_s])),
        ..frame(&Pose::from_kuka(xyz_mm, abc_deg))
    }
}
