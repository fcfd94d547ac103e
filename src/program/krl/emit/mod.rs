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

use std::net::SocketAddrV4;

use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context};

use crate::catalogue::{ProgramFinding, ReportFinding};
use crate::diagnostic::Diagnostic;
use crate::plan::job::Outputs;
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Frames, Kind, MODULE_DWELLS, Motion, Plan, PlanRow};
use crate::program::krl::header;
use crate::program::sequence::{Bar, Module, Step, Timed, modules};
use crate::provenance::Provenance;
use crate::robot::{Joint, Robot};

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

/// How the dwells are marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sync {
    /// By the plan's own sync markers in the length alone; the program sets no output.
    Marker,
    /// By a strobe and an index on digital outputs as well.
    Output,
    /// By telegrams over EthernetKRL (KR C4 and later, an option package): dbbd is the server.
    Ekrl {
        /// As the controller's line network sees it.
        server: SocketAddrV4,
    },
}

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

/// The modules of a plan, each a file name and its text (ASCII, CR LF). The first is the master's code.
pub fn emit(plan: &Plan, options: Options) -> Result<Vec<(String, String)>, Diagnostic> {
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let engine = engine().map_err(|error| no_text("KRL", &error))?;
    let writer = Writer { plan, options, texts: texts(plan, robot.controller(), options)?, engine };
    let modules = modules(plan)?;
    let called = modules.iter().zip(1..).map(|(module, number)| {
        let stays = module.bar == Bar::Stays;
        context! { name => name(number), stays => stays }
    });
    let of_all = context! { plan => &writer.texts, modules => called.collect::<Value>() };
    let mut files = vec![
        ("DBB_MAIN.src".into(), writer.fill("main.src", &of_all)?),
        ("DBB_MAIN.dat".into(), writer.fill("main.dat", &of_all)?),
    ];
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(ProgramFinding::NoEthernetKrl.into());
        }
        let address = context! { ip => server.ip().to_string(), port => server.port() };
        files.push(("DbbEki.xml".into(), writer.fill("channel.xml", &address)?));
    }
    for (module, number) in modules.iter().zip(1..) {
        files.extend(writer.module(module, &name(number))?);
    }
    Ok(files)
}

fn name(number: usize) -> String {
    format!("DBB_C{number:03}")
}

/// What every file may say of the plan.
fn texts(plan: &Plan, robot: &Robot, options: Options) -> Result<Value, Diagnostic> {
    let job = &plan.header.job;
    let sync = match options.sync {
        Sync::Marker => "marker",
        Sync::Output => "output",
        Sync::Ekrl { .. } => "ekrl",
    };
    let [.., a, b, c] = job.motion.tool.unwrap_or_default();
    let [x, y, z] = robot.geometry.tool.into();
    // The one mass on the flange, where the robot file has it.
    let mut carried = robot.geometry.masses.iter().filter(|mass| mass.joint == Joint::J6);
    let payload = carried.next().filter(|_| carried.next().is_none());
    Ok(context! {
        hash => character_text(&plan.header.hash, 32),
        robot => character_text(&robot.name, 64),
        run => run_number(&plan.header.hash).unwrap_or(0),
        // What the program was made from.
        made => Value::from_iter(header::lines(&Provenance::of([&plan.traced()?]))?),
        krc2 => options.controller == Controller::Krc2,
        sync => sync,
        outputs => Serde(&job.motion.outputs),
        bar => Serde(&job.bar),
        settle_s => job.motion.settle_s,
        tool => Serde([x, y, z, a, b, c]),
        base => Serde(job.motion.base.unwrap_or_default()),
        payload => payload.map(|mass| context! { kg => mass.kg, centre => unturned(mass.centre.into()) }),
        ptp_acceleration_percent => PTP_ACCELERATION_PERCENT,
        acceleration_mm_s2 => ACCELERATION_MM_S2,
        acceleration_deg_s2 => ACCELERATION_DEG_S2,
    })
}

struct Writer<'a> {
    plan: &'a Plan,
    options: Options,
    texts: Value,
    engine: Environment<'static>,
}

impl Writer<'_> {
    fn fill(&self, template: &str, context: &Value) -> Result<String, Diagnostic> {
        let text = self.engine.get_template(template).and_then(|template| template.render(context));
        text.map(|text| text.replace('\n', "\r\n")).map_err(|error| no_text(template, &error))
    }

    fn module(&self, module: &Module<'_>, name: &str) -> Result<[(String, String); 2], Diagnostic> {
        let (circle, dwells) = (module.circle, module.counted().count());
        if dwells > MODULE_DWELLS as usize {
            return Err(ProgramFinding::TooManyDwells { circle, dwells, most: MODULE_DWELLS }.into());
        }
        let steps = module.steps()?;
        let job = &self.plan.header.job;
        let ball = module.ball;
        let Some(table) = job.centres.iter().find(|table| table.id == ball) else {
            return Err(ProgramFinding::NoBall { ball }.into());
        };
        if self.options.sync == Sync::Output {
            check_outputs(&job.motion.outputs)?;
        }
        module.rows.iter().try_for_each(check)?;
        let frames = job.motion.frames();
        let context = context! {
            plan => &self.texts,
            name => name,
            circle => circle,
            ball => ball,
            stays => module.bar == Bar::Stays,
            centre => unturned(table.xyz_mm),
            start_deg => Serde(module.start.row.axes_deg),
            start_percent => module.start.time.axis_percent,
            steps => steps.iter().map(step_text).collect::<Value>(),
            end_mark => module.end_mark(),
            points => module.rows.iter().map(|timed| point_text(timed, &frames)).collect::<Value>(),
            rows => module.counted().map(|timed| timed.row.index).collect::<Value>(),
            stops => module.rows.iter().any(|timed| timed.row.kind != Kind::Transit),
            passes => module.rows.iter().any(|timed| timed.pass.is_some()),
        };
        let (source, data) = (self.fill("circle.src", &context)?, self.fill("circle.dat", &context)?);
        let lines = source.matches('\n').count().max(data.matches('\n').count());
        if lines > LINES {
            return Err(ProgramFinding::TooManyLines { circle, lines, most: LINES }.into());
        }
        Ok([(format!("{name}.src"), source), (format!("{name}.dat"), data)])
    }
}

fn step_text(step: &Step<'_>) -> Value {
    match *step {
        Step::Pass { row, pass, number } => context! { row => row, pass => Serde(pass), number => number },
        Step::Move { row, timed: Timed { row: pose, time, .. }, through, dwell } => context! {
            row => row,
            pass => false,
            number => dwell,
            through => through,
            index => pose.index,
            kind => Serde(pose.kind),
            motion => Serde(pose.motion),
            dwell_s => pose.dwell_s,
            axis_percent => time.axis_percent,
        },
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

fn unturned([x, y, z]: [f64; 3]) -> Value {
    Serde([x, y, z, 0.0, 0.0, 0.0]).into()
}

fn engine() -> Result<Environment<'static>, minijinja::Error> {
    let mut engine = Environment::new();
    engine.set_undefined_behavior(UndefinedBehavior::Strict);
    let syntax =
        SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true).build()?;
    engine.set_syntax(syntax);
    engine.add_filter("mm", |value: f64| fixed(value, 3));
    engine.add_filter("deg", |value: f64| fixed(value, 4));
    engine.add_filter("speed", |value: f64| fixed(value, 6));
    engine.add_filter("seconds", |value: f64| fixed(value, 3));
    // The controller rounds; never more than asked.
    engine.add_filter("percent", |value: f64| fixed(value.floor(), 0));
    for (name, text) in TEMPLATES {
        engine.add_template(name, text)?;
    }
    Ok(engine)
}

fn no_text(file: &str, error: &minijinja::Error) -> Diagnostic {
    let why = error.detail().map_or_else(|| error.to_string(), str::to_owned);
    ReportFinding::NoPage { page: file.into(), why }.into()
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

/// What KRL can hold: finite numbers, status and turn bits, speeds above zero.
fn check(timed: &Timed<'_>) -> Result<(), ProgramFinding> {
    let Timed { row: PlanRow { index: row, status, turn, dwell_s, motion, .. }, time, .. } = *timed;
    let (&row, &status, &turn, &dwell_s) = (row, status, turn, dwell_s);
    if time.index != row {
        return Err(ProgramFinding::OtherMove { row, index: time.index });
    }
    let numbers = timed.row.xyz_mm.iter().chain(&timed.row.abc_deg).chain(&timed.row.axes_deg);
    if let Some(&value) = numbers.into_iter().find(|value| !value.is_finite() || value.abs() >= 1e6) {
        return Err(ProgramFinding::RowNumber { row, value });
    }
    if status > 31 || turn > 63 {
        return Err(ProgramFinding::RowConfiguration { row, status, turn });
    }
    if !(0.0..=600.0).contains(&dwell_s) {
        return Err(ProgramFinding::RowDwell { row, dwell_s });
    }
    let (percent, feed_mm_s, turn_deg_s) = (time.axis_percent, time.feed_mm_s, time.turn_deg_s);
    match motion {
        Motion::Ptp if !(1.0..=100.0).contains(&percent) => {
            Err(ProgramFinding::RowAxisSpeed { row, percent })
        }
        Motion::Ptp => Ok(()),
        _ if timed.is_auxiliary() => Ok(()),
        _ if !(0.01..=2000.0).contains(&feed_mm_s) => Err(ProgramFinding::RowFeed { row, feed_mm_s }),
        _ if !(0.01..=1000.0).contains(&turn_deg_s) => Err(ProgramFinding::RowTurn { row, turn_deg_s }),
        _ => Ok(()),
    }
}

/// A number with so many decimals, without a minus before zero.
pub(super) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(positive) if positive.chars().all(|c| c == '0' || c == '.') => positive.to_owned(),
        _ => text,
    }
}

/// A text for a CHAR array or a comment: printable ASCII without quotes, at most `length` characters.
fn character_text(text: &str, length: usize) -> String {
    let plain = |c: char| if c == ' ' || (c.is_ascii_graphic() && c != '"' && c != ';') { c } else { '_' };
    text.chars().map(plain).take(length).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_has_no_sign_and_no_number_an_exponent() {
        assert_eq!(fixed(-0.0, 3), "0.000");
        assert_eq!(fixed(-0.000_4, 3), "0.000");
        assert_eq!(fixed(-0.000_6, 3), "-0.001");
        assert_eq!(fixed(1e-9, 4), "0.0000");
        assert_eq!(fixed(-123_456.789_01, 4), "-123456.7890");
    }
}
