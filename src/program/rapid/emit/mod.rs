//! Writes the RAPID modules of a plan: one for each circle, under a main module that calls them.
//!
//! A module does what that of KRL does (see [`crate::program::krl::emit`]), by the signals `DBBSTB` (a digital output) and
//! `DBBIDX` (a group of eight), which the controller's configuration must have. Dwells wait for the robot to be in
//! position and at zero speed, because `fine` ends a motion when its command ends. Points to which the axes go together
//! are written as axis angles; of the others the configuration (`confdata`) is that of the plan's axis angles, and
//! `ConfL\Off` keeps lines and arcs in the branch of the start.

use minijinja::context;
use minijinja::value::{Serde, Value};

use crate::diagnostic::Diagnostic;
use crate::plan::timing::ACCELERATION_MM_S2;
use crate::plan::{Frames, Motion, Plan};
use crate::program::Language;
use crate::program::emission::{
    Sync, Templates, Written, called, module_text, name, only_stops, payload, plan_text,
};
use crate::program::sequence::{Timed, modules};
use crate::robot::{Pose, Robot, inverse};

const TEMPLATES: [(&str, &str); 3] = [
    ("main.mod", include_str!("main.mod")),
    ("circle.mod", include_str!("circle.mod")),
    ("program.pgf", include_str!("program.pgf")),
];

/// The modules of a plan (ASCII, CR LF) and the program file that lists them; the first is the main module.
pub fn emit(plan: &Plan, sync: Sync) -> Result<Written, Diagnostic> {
    only_stops(plan, Language::Rapid, sync)?;
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let controller = robot.controller();
    let templates = Templates::new(&TEMPLATES)?;
    let texts = texts(plan, controller, sync)?;
    let modules = modules(plan)?;
    let of_all = context! { plan => &texts, modules => called(&modules) };
    let mut files = vec![
        ("DBB_MAIN.mod".into(), templates.fill("main.mod", &of_all)?),
        ("DBB.pgf".into(), templates.fill("program.pgf", &of_all)?),
    ];
    let frames = plan.header.job.motion.frames();
    for (module, number) in modules.iter().zip(1..) {
        let name = name(number);
        let points = module.rows.iter().map(|timed| point_text(timed, &frames, controller));
        let context = context! {
            plan => &texts,
            name => &name,
            points => points.collect::<Value>(),
            ..module_text(plan, module)?
        };
        files.push((format!("{name}.mod"), templates.fill("circle.mod", &context)?));
    }
    Ok(files)
}

/// What every file may say of the plan.
fn texts(plan: &Plan, robot: &Robot, sync: Sync) -> Result<Value, Diagnostic> {
    let motion = &plan.header.job.motion;
    let [.., a, b, c] = motion.tool.unwrap_or_default();
    let [x, y, z, u, v, w] = motion.base.unwrap_or_default();
    // A controller refuses a tool without mass.
    let (kg, centre) =
        payload(robot).map_or((0.001, [0.0, 0.0, 0.001]), |mass| (mass.kg, mass.centre.into()));
    Ok(context! {
        tool => frame(&Pose::from_kuka(robot.geometry.tool.into(), [a, b, c])),
        base => frame(&Pose::from_kuka([x, y, z], [u, v, w])),
        payload => context! { kg => kg, centre => Serde(centre) },
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        ..plan_text(plan, Language::Rapid, sync)?
    })
}

fn frame(pose: &Pose) -> Value {
    let place: [f64; 3] = pose.position.into();
    context! { place => Serde(place), turn => Serde(pose.quaternion()) }
}

fn point_text(timed: &Timed<'_>, frames: &Frames, robot: &Robot) -> Value {
    let Timed { row, time, .. } = timed;
    if row.motion == Motion::Ptp {
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
