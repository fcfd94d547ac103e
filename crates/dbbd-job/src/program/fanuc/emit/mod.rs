//! Emits the listings of a plan: a program for each circle, and a main program that calls them.
//!
//! A program does the same as a module of KRL (see [`crate::program::krl::emit`]), with the strobe on a digital output and the
//! index on the group output 1. A listing has three decimals, so that an axis angle is right to 0.0005 degrees, which is 9 um at
//! a metre: where CONFIG selects the branch with certainty, a position is a pose, else axis angles. The program sets its tool and
//! user frame itself, by a position register.

use minijinja::context;
use minijinja::value::{Serde, Value};

use super::position::swapped;
use super::renumbered;
use crate::plan::Plan;
use crate::program::Language;
use crate::program::emission::{
    Sync, Templates, Written, module_calls, module_variables, name, plan_variables, printed_frames,
    refuse_krl_only,
};
use crate::program::sequence::{Timed, modules};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::inverse::FanucConfiguration;
use dbbd_model::robot::{Geometry, Robot};

const TEMPLATES: [(&str, &str); 3] = [
    ("head.ls", include_str!("head.ls")),
    ("main.ls", include_str!("main.ls")),
    ("circle.ls", include_str!("circle.ls")),
];

/// The listings of a plan (ASCII, CR LF); the first is the main program.
pub fn emit(plan: &Plan, sync: Sync) -> Result<Written, Diagnostic> {
    refuse_krl_only(plan, Language::Fanuc, sync)?;
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let geometry = &robot.controller().geometry;
    let motion = &plan.header.job.motion;
    let [tool, base] = printed_frames(motion, robot.controller());
    let variables = context! {
        tool => Serde(swapped(tool)),
        base => Serde(swapped(base)),
        ..plan_variables(plan, Language::Fanuc, sync)?
    };
    let templates = Templates::new(&TEMPLATES)?;
    let modules = modules(plan)?;
    let of_all = context! { plan => &variables, name => "DBB_MAIN", modules => module_calls(&modules) };
    let mut files = vec![("DBB_MAIN.ls".into(), renumbered(&templates.render("main.ls", &of_all)?))];
    let frames = motion.frames();
    for (module, number) in modules.iter().zip(1..) {
        let name = name(number);
        let points = module.rows.iter().map(|timed| {
            let (xyz_mm, abc_deg) = frames.printed(timed.row);
            point_variables(timed, [xyz_mm, abc_deg], geometry)
        });
        let context = context! {
            plan => &variables,
            name => &name,
            points => points.collect::<Value>(),
            ..module_variables(plan, module)?
        };
        files.push((format!("{name}.ls"), renumbered(&templates.render("circle.ls", &context)?)));
    }
    Ok(files)
}

fn point_variables(timed: &Timed<'_>, [[x, y, z], [a, b, c]]: [[f64; 3]; 2], geometry: &Geometry) -> Value {
    let Timed { row, time, .. } = timed;
    let config = FanucConfiguration::certain(geometry, &row.axes_deg.map(f64::to_radians));
    context! {
        axes => Serde(row.axes_deg),
        pose => Serde(swapped([x, y, z, a, b, c])),
        config => config.map(|config| config.to_string()),
        feed_mm_s => time.feed_mm_s,
    }
}
