//! Writes the KRL modules of a plan: one for each circle, under a master that calls them.
//!
//! A module drives to an axis position, halts for the bar to be mounted, marks its start, and goes through its rows. A
//! dwell is: arrive, settle, index on the outputs, log the measured axes, strobe high while the robot is at rest, strobe
//! low. A pass of a continuous circle is one such: settle, strobe high, one motion, strobe low, log. All stops are
//! exact: outputs set in the advance run would come before the robot does.
//!
//! With [`Sync::Ekrl`] the controller is a client of dbbd: `<Dbb>` carries the run, the plan's row, the phase (1: the
//! robot is at rest, 2: the dwell is over) and the measured axes, and `<Ack Id=".."/>` answers it.
//!
//! The text of the files is in the templates beside this one; what KRL cannot hold is refused here.

use minijinja::context;
use minijinja::value::{Serde, Value};

use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::job::Outputs;
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Frames, Motion, Plan};
use crate::program::Language;
pub use crate::program::emission::Sync;
use crate::program::emission::{Templates, Written, called, module_text, name, payload, plan_text, unturned};
use crate::program::sequence::{Module, Timed, modules};
use crate::robot::Robot;

/// Lines that a module may have: longer files are known to make trouble on old controllers.
const LINES: usize = 2000;

const TEMPLATES: [(&str, &str); 6] = [
    ("parts.krl", include_str!("parts.krl")),
    ("main.src", include_str!("main.src")),
    ("main.dat", include_str!("main.dat")),
    ("circle.src", include_str!("circle.src")),
    ("circle.dat", include_str!("circle.dat")),
    ("channel.xml", include_str!("channel.xml")),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Controller {
    // No doc comments: the help would list them. KSS 5: modules elsewhere must be declared `EXT`.
    Krc2,
    // KSS 8.
    Krc4,
    // KSS 8.7, the same language.
    Krc5,
    // That of `dbbd simulate`, which moves robots of any make.
    Simulated,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    pub sync: Sync,
    pub controller: Controller,
}

/// The number of the plan with this hash, by which a server recognises its run; `None` if it is no hash.
pub fn run_number(hash: &str) -> Option<u32> {
    u32::from_str_radix(hash.get(..4)?, 16).ok()
}

/// The modules of a plan (ASCII, CR LF); the first file is the master's code.
pub fn emit(plan: &Plan, options: Options) -> Result<Written, Diagnostic> {
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let writer = Writer {
        plan,
        options,
        texts: texts(plan, robot.controller(), options)?,
        templates: Templates::new(&TEMPLATES)?,
    };
    let modules = modules(plan)?;
    let of_all = context! { plan => &writer.texts, modules => called(&modules) };
    let mut files = vec![
        ("DBB_MAIN.src".into(), writer.templates.fill("main.src", &of_all)?),
        ("DBB_MAIN.dat".into(), writer.templates.fill("main.dat", &of_all)?),
    ];
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(ProgramFinding::NoEthernetKrl.into());
        }
        let address = context! { ip => server.ip().to_string(), port => server.port() };
        files.push(("DbbEki.xml".into(), writer.templates.fill("channel.xml", &address)?));
    }
    for (module, number) in modules.iter().zip(1..) {
        files.extend(writer.module(module, &name(number))?);
    }
    Ok(files)
}

/// What every file may say of the plan.
fn texts(plan: &Plan, robot: &Robot, options: Options) -> Result<Value, Diagnostic> {
    let job = &plan.header.job;
    let [.., a, b, c] = job.motion.tool.unwrap_or_default();
    let [x, y, z] = robot.geometry.tool.into();
    Ok(context! {
        run => run_number(&plan.header.hash).unwrap_or(0),
        krc2 => options.controller == Controller::Krc2,
        tool => Serde([x, y, z, a, b, c]),
        base => Serde(job.motion.base.unwrap_or_default()),
        payload => payload(robot).map(|mass| context! { kg => mass.kg, centre => unturned(mass.centre.into()) }),
        ptp_acceleration_percent => PTP_ACCELERATION_PERCENT,
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        acceleration_deg_s2 => ACCELERATION_DEG_S2,
        ..plan_text(plan, Language::Krl, options.sync)?
    })
}

struct Writer<'a> {
    plan: &'a Plan,
    options: Options,
    texts: Value,
    templates: Templates,
}

impl Writer<'_> {
    fn module(&self, module: &Module<'_>, name: &str) -> Result<[(String, String); 2], Diagnostic> {
        let circle = module.circle;
        let facts = module_text(self.plan, module)?;
        let job = &self.plan.header.job;
        if self.options.sync == Sync::Output {
            check_outputs(&job.motion.outputs)?;
        }
        let frames = job.motion.frames();
        let context = context! {
            plan => &self.texts,
            name => name,
            points => module.rows.iter().map(|timed| point_text(timed, &frames)).collect::<Value>(),
            ..facts
        };
        let fill = |template: &str| self.templates.fill(template, &context);
        let (source, data) = (fill("circle.src")?, fill("circle.dat")?);
        let lines = source.matches('\n').count().max(data.matches('\n').count());
        if lines > LINES {
            return Err(ProgramFinding::TooManyLines { circle, lines, most: LINES }.into());
        }
        Ok([(format!("{name}.src"), source), (format!("{name}.dat"), data)])
    }
}

fn point_text(timed: &Timed<'_>, frames: &Frames) -> Value {
    let Timed { row, time, .. } = timed;
    let ([x, y, z], [a, b, c]) = frames.printed(row);
    // Along the path, m/s, and of the orientation, deg/s.
    let speeds = || Value::from_iter([time.feed_mm_s * 1e-3, time.turn_deg_s]);
    let has_speeds = row.motion != Motion::Ptp && !timed.is_auxiliary();
    context! {
        pose => Serde([x, y, z, a, b, c]),
        status => row.status,
        turn => row.turn,
        speeds => has_speeds.then(speeds),
    }
}

/// Strobe and index on the outputs of the job.
fn check_outputs(outputs: &Outputs) -> Result<(), ProgramFinding> {
    let [first, last] = outputs.index;
    let within = [outputs.strobe, first, last].into_iter().all(|output| (1..=4096).contains(&output));
    let eight = last.checked_sub(first) == Some(7);
    if !(within && eight) || (first..=last).contains(&outputs.strobe) {
        return Err(ProgramFinding::OutputsOverlap);
    }
    Ok(())
}
