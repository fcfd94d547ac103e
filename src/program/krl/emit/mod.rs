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
use minijinja::value::Serde;
use minijinja::{Environment, UndefinedBehavior};
use serde::Serialize;

use crate::catalogue::{ProgramFinding, ReportFinding};
use crate::diagnostic::Diagnostic;
use crate::plan::job::{self, Outputs};
use crate::plan::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT};
use crate::plan::{Kind, MODULE_DWELLS, Motion, Pass, Plan, PlanRow};
use crate::program::krl::header;
use crate::program::sequence::{self, Bar, Module, Timed, modules};
use crate::provenance::Provenance;
use crate::robot::{AXES, Joint, Mass, Robot};

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
    let writer = Writer::new(plan, robot.controller(), options)?;
    let modules = modules(plan)?;
    let of_all = Circles {
        plan: &writer.texts,
        modules: modules.iter().zip(1..).map(|(module, number)| Called::new(module, number)).collect(),
    };
    let mut files = vec![
        ("DBB_MAIN.src".into(), writer.fill("main.src", &of_all)?),
        ("DBB_MAIN.dat".into(), writer.fill("main.dat", &of_all)?),
    ];
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(ProgramFinding::NoEthernetKrl.into());
        }
        let address = Address { ip: server.ip().to_string(), port: server.port() };
        files.push(("DbbEki.xml".into(), writer.fill("channel.xml", &address)?));
    }
    for (module, called) in modules.iter().zip(of_all.modules) {
        files.extend(writer.module(module, called)?);
    }
    Ok(files)
}

/// What every file may say of the plan.
#[derive(Serialize)]
struct Texts<'a> {
    hash: String,
    robot: String,
    run: u32,
    /// Comments that say what the program was made from.
    made: Vec<String>,
    krc2: bool,
    sync: &'static str,
    outputs: &'a Outputs,
    bar: &'a job::Bar,
    settle_s: f64,
    tool: [f64; 6],
    base: [f64; 6],
    payload: Option<Payload>,
    ptp_acceleration_percent: f64,
    acceleration_mm_s2: f64,
    acceleration_deg_s2: f64,
}

#[derive(Serialize)]
struct Payload {
    kg: f64,
    centre: [f64; 6],
}

#[derive(Serialize)]
struct Circles<'a> {
    plan: &'a Texts<'a>,
    modules: Vec<Called>,
}

#[derive(Serialize)]
struct Called {
    name: String,
    stays: bool,
}

#[derive(Serialize)]
struct Address {
    ip: String,
    port: u16,
}

#[derive(Serialize)]
struct Circle<'a> {
    plan: &'a Texts<'a>,
    #[serde(flatten)]
    called: Called,
    circle: u32,
    ball: u32,
    centre: [f64; 6],
    start_deg: [f64; AXES],
    start_percent: f64,
    steps: Vec<Step<'a>>,
    end_mark: usize,
    points: Vec<Point>,
    /// Of the plan, by dwell.
    rows: Vec<u32>,
    /// Whether it has dwells, and passes.
    stops: bool,
    passes: bool,
}

/// A motion to a row of the module, counted from 1, or the pass that ends there.
#[derive(Serialize)]
struct Step<'a> {
    row: usize,
    /// Of the dwell or pass.
    number: Option<usize>,
    pass: Option<&'a Pass>,
    index: u32,
    kind: Kind,
    motion: Motion,
    through: Option<usize>,
    axis_percent: f64,
    dwell_s: f64,
}

#[derive(Serialize)]
struct Point {
    pose: [f64; 6],
    status: u8,
    turn: u8,
    /// Along the path, m/s, and of the orientation, deg/s.
    speeds: Option<[f64; 2]>,
}

impl Called {
    fn new(module: &Module<'_>, number: usize) -> Self {
        Self { name: format!("DBB_C{number:03}"), stays: module.bar == Bar::Stays }
    }
}

impl<'a> Step<'a> {
    fn new(module: &Module<'a>, step: &sequence::Step<'a>) -> Option<Self> {
        let Timed { row, time, .. } = module.rows.get(step.row().checked_sub(1)?)?;
        let (number, pass, through) = match *step {
            sequence::Step::Move { dwell, through, .. } => (dwell, None, through),
            sequence::Step::Pass { number, pass, .. } => (Some(number), Some(pass), None),
        };
        let &PlanRow { index, kind, motion, dwell_s, .. } = *row;
        let (row, axis_percent) = (step.row(), time.axis_percent);
        Some(Self { row, number, pass, index, kind, motion, through, axis_percent, dwell_s })
    }
}

struct Writer<'a> {
    plan: &'a Plan,
    texts: Texts<'a>,
    engine: Environment<'static>,
}

impl<'a> Writer<'a> {
    fn new(plan: &'a Plan, robot: &Robot, options: Options) -> Result<Self, Diagnostic> {
        let job = &plan.header.job;
        let [.., a, b, c] = job.motion.tool.unwrap_or_default();
        let [x, y, z] = robot.geometry.tool.into();
        // The one mass on the flange, where the robot file has it.
        let mut carried = robot.geometry.masses.iter().filter(|mass| mass.joint == Joint::J6);
        let payload = |&Mass { kg, centre, .. }: &Mass| Payload { kg, centre: unturned(centre.into()) };
        let texts = Texts {
            hash: character_text(&plan.header.hash, 32),
            robot: character_text(&robot.name, 64),
            run: run_number(&plan.header.hash).unwrap_or(0),
            made: header::lines(&Provenance::of([&plan.traced()?]))?,
            krc2: options.controller == Controller::Krc2,
            sync: match options.sync {
                Sync::Marker => "marker",
                Sync::Output => "output",
                Sync::Ekrl { .. } => "ekrl",
            },
            outputs: &job.motion.outputs,
            bar: &job.bar,
            settle_s: job.motion.settle_s,
            tool: [x, y, z, a, b, c],
            base: job.motion.base.unwrap_or_default(),
            payload: carried.next().filter(|_| carried.next().is_none()).map(payload),
            ptp_acceleration_percent: PTP_ACCELERATION_PERCENT,
            acceleration_mm_s2: ACCELERATION_MM_S2,
            acceleration_deg_s2: ACCELERATION_DEG_S2,
        };
        let engine = engine().map_err(|error| no_text("KRL", &error))?;
        Ok(Self { plan, texts, engine })
    }

    fn fill(&self, template: &str, context: &impl Serialize) -> Result<String, Diagnostic> {
        let text = self.engine.get_template(template).and_then(|template| template.render(Serde(context)));
        text.map(|text| text.replace('\n', "\r\n")).map_err(|error| no_text(template, &error))
    }

    fn module(&self, module: &Module<'_>, called: Called) -> Result<[(String, String); 2], Diagnostic> {
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
        if self.texts.sync == "output" {
            check_outputs(&job.motion.outputs)?;
        }
        let frames = job.motion.frames();
        let point = |timed: &Timed<'_>| {
            check(timed)?;
            let Timed { row, time, .. } = timed;
            let ([x, y, z], [a, b, c]) = frames.printed(row);
            let straight = row.motion != Motion::Ptp && !timed.is_auxiliary();
            let speeds = straight.then_some([time.feed_mm_s * 1e-3, time.turn_deg_s]);
            Ok(Point { pose: [x, y, z, a, b, c], status: row.status, turn: row.turn, speeds })
        };
        let circle_text = Circle {
            plan: &self.texts,
            circle,
            ball,
            centre: unturned(table.xyz_mm),
            start_deg: module.start.row.axes_deg,
            start_percent: module.start.time.axis_percent,
            steps: steps.iter().filter_map(|step| Step::new(module, step)).collect(),
            end_mark: module.end_mark(),
            points: module.rows.iter().map(point).collect::<Result<_, ProgramFinding>>()?,
            rows: module.counted().map(|timed| timed.row.index).collect(),
            stops: module.rows.iter().any(|timed| timed.row.kind != Kind::Transit),
            passes: module.rows.iter().any(|timed| timed.pass.is_some()),
            called,
        };
        let texts = [self.fill("circle.src", &circle_text)?, self.fill("circle.dat", &circle_text)?];
        let lines = texts.iter().map(|text| text.matches('\n').count()).max().unwrap_or(0);
        if lines > LINES {
            return Err(ProgramFinding::TooManyLines { circle, lines, most: LINES }.into());
        }
        let [source, data] = texts;
        let name = circle_text.called.name;
        Ok([(format!("{name}.src"), source), (format!("{name}.dat"), data)])
    }
}

fn unturned([x, y, z]: [f64; 3]) -> [f64; 6] {
    [x, y, z, 0.0, 0.0, 0.0]
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
