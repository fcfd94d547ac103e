//! Emits the KRL modules of a plan: one for each circle, and a main module that calls them.
//!
//! A module moves to its start, halts for the mounting of the bar, emits a sync marker, and moves through its rows. At a
//! dwell the robot stops and settles; the program sets the index outputs, logs the measured axes, and holds the strobe output
//! high during the dwell. A pass (a continuous circle) has the strobe high during its one motion, and logs the axes after it.
//! All stops are exact: an output set in the advance run would precede the robot.
//!
//! With [`Sync::Ekrl`] the controller is a client of dbbd: it sends `<Dbb>` with the run, the row of the plan, the phase (1:
//! the robot is at rest, 2: the dwell is over) and the measured axes, and waits for `<Ack Id=".."/>`.
//!
//! The text of the files is in the templates beside this file; data that KRL cannot express are refused here.

use minijinja::context;
use minijinja::value::{Serde, Value};

use crate::plan::job::MarkerOutputs;
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{MotionKind, Plan, PlanFrames};
use crate::program::Language;
use crate::program::ProgramFinding;
pub use crate::program::emission::Sync;
use crate::program::emission::{
    Templates, Written, module_calls, module_variables, name, plan_variables, printed_frames,
    without_rotation,
};
use crate::program::sequence::{Module, Timed, modules};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// Most lines of a file: longer ones are known to cause trouble on old controllers.
const LINES: usize = 2000;

const TEMPLATES: [(&str, &str); 6] = [
    ("parts.krl", include_str!("parts.krl")),
    ("main.src", include_str!("main.src")),
    ("main.dat", include_str!("main.dat")),
    ("circle.src", include_str!("circle.src")),
    ("circle.dat", include_str!("circle.dat")),
    ("channel.xml", include_str!("channel.xml")),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Controller {
    /// KSS 5: external modules must be declared with `EXT`.
    Krc2,
    /// KSS 8.
    Krc4,
    /// KSS 8.7, the same language.
    Krc5,
    /// The controller of `dbbd simulate`, for robots of any make.
    Simulated,
}

impl Controller {
    pub const ALL: [Self; 4] = [Self::Krc2, Self::Krc4, Self::Krc5, Self::Simulated];

    /// The name of the controller on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Krc2 => "krc2",
            Self::Krc4 => "krc4",
            Self::Krc5 => "krc5",
            Self::Simulated => "simulated",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    pub sync: Sync,
    pub controller: Controller,
}

/// The number by which a server recognises the run of the plan with this hash: the first 24 bits of the hash, which an
/// INT of KRL holds; `None` if the text is no hash.
pub fn run_number(hash: &str) -> Option<u32> {
    u32::from_str_radix(hash.get(..6)?, 16).ok()
}

/// The modules of a plan (ASCII, CR LF); the first file is the code of the main module.
pub fn emit(plan: &Plan, options: Options) -> Result<Written, Diagnostic> {
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let writer = Writer {
        plan,
        options,
        variables: variables(plan, robot.controller(), options)?,
        templates: Templates::new(&TEMPLATES)?,
    };
    let modules = modules(plan)?;
    let of_all = context! { plan => &writer.variables, modules => module_calls(&modules) };
    let mut files = vec![
        ("DBB_MAIN.src".into(), writer.templates.render("main.src", &of_all)?),
        ("DBB_MAIN.dat".into(), writer.templates.render("main.dat", &of_all)?),
    ];
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(ProgramFinding::NoEthernetKrl.into());
        }
        let address = context! { ip => server.ip().to_string(), port => server.port() };
        files.push(("DbbEki.xml".into(), writer.templates.render("channel.xml", &address)?));
    }
    for (module, number) in modules.iter().zip(1..) {
        files.extend(writer.module(module, &name(number))?);
    }
    Ok(files)
}

/// The variables of the plan for the templates.
fn variables(plan: &Plan, robot: &Robot, options: Options) -> Result<Value, Diagnostic> {
    let job = &plan.header.job;
    let [tool, base] = printed_frames(&job.motion, robot);
    Ok(context! {
        run => run_number(&plan.header.hash).unwrap_or(0),
        krc2 => options.controller == Controller::Krc2,
        tool => Serde(tool),
        base => Serde(base),
        payload => robot.geometry.load.carried().map(|payload| context! { kg => payload.kg, centre => without_rotation(payload.centre.into()) }),
        ptp_acceleration_percent => PTP_ACCELERATION_PERCENT,
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        acceleration_deg_s2 => ACCELERATION_DEG_S2,
        ..plan_variables(plan, Language::Krl, options.sync)?
    })
}

struct Writer<'a> {
    plan: &'a Plan,
    options: Options,
    variables: Value,
    templates: Templates,
}

impl Writer<'_> {
    fn module(&self, module: &Module<'_>, name: &str) -> Result<[(String, String); 2], Diagnostic> {
        let circle = module.circle;
        let module_variables = module_variables(self.plan, module)?;
        let job = &self.plan.header.job;
        if self.options.sync == Sync::Output {
            check_outputs(&job.motion.outputs)?;
        }
        let frames = job.motion.frames();
        let context = context! {
            plan => &self.variables,
            name => name,
            points => module.rows.iter().map(|timed| point_variables(timed, &frames)).collect::<Value>(),
            ..module_variables
        };
        let render = |template: &str| self.templates.render(template, &context);
        let (source, data) = (render("circle.src")?, render("circle.dat")?);
        let lines = source.matches('\n').count().max(data.matches('\n').count());
        if lines > LINES {
            return Err(ProgramFinding::TooManyLines { circle, lines, most: LINES }.into());
        }
        Ok([(format!("{name}.src"), source), (format!("{name}.dat"), data)])
    }
}

fn point_variables(timed: &Timed<'_>, frames: &PlanFrames) -> Value {
    let Timed { row, time, .. } = timed;
    let ([x, y, z], [a, b, c]) = frames.printed(row);
    // Speeds along the path, m/s, and of the orientation, deg/s.
    let speeds = || Value::from_iter([time.feed_mm_s * 1e-3, time.turn_deg_s]);
    let has_speeds = row.motion != MotionKind::Ptp && !timed.is_auxiliary();
    context! {
        pose => Serde([x, y, z, a, b, c]),
        status => row.status,
        turn => row.turn,
        speeds => has_speeds.then(speeds),
    }
}

/// Refuses outputs for strobe and index that do not exist, are not eight or overlap.
fn check_outputs(outputs: &MarkerOutputs) -> Result<(), ProgramFinding> {
    let [first, last] = outputs.index;
    let within = [outputs.strobe, first, last].into_iter().all(|output| (1..=4096).contains(&output));
    let eight = last.checked_sub(first) == Some(7);
    if !(within && eight) || (first..=last).contains(&outputs.strobe) {
        return Err(ProgramFinding::OutputsOverlap);
    }
    Ok(())
}
