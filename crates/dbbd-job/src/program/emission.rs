//! Shared by the emitters of all languages: the variables of the templates, and the checks for data that no controller
//! accepts.

use std::net::SocketAddrV4;

use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context};

use super::sequence::{Bar, Module, Step, Timed};
use super::text::fixed;
use super::{Language, header};
use crate::plan::job::MotionTable;
use crate::plan::timing::MARKER_MM_S;
use crate::plan::{MODULE_DWELLS, MotionKind, Plan, PlanRow, PoseKind};
use crate::program::ProgramFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::plausibility::Quantity;
use dbbd_model::robot::{ControllerFrames, Pose, Robot};

/// The files of a program, names and texts; the program begins in the first.
pub type Written = Vec<(String, String)>;

/// The way in which the dwells are marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sync {
    /// The sync markers of the plan alone mark the dwells; the program sets no output.
    Marker,
    /// A strobe and an index on digital outputs mark the dwells as well.
    Output,
    /// Telegrams over EthernetKRL (an option of KUKA's KR C4 and later) mark the dwells as well; dbbd is the server.
    Ekrl {
        /// The address of the server in the network of the controller.
        server: SocketAddrV4,
    },
}

impl Sync {
    fn name(self) -> &'static str {
        match self {
            Self::Marker => "marker",
            Self::Output => "output",
            Self::Ekrl { .. } => "ekrl",
        }
    }
}

/// The name of the module of the `number`-th circle, from 1.
pub(super) fn name(number: usize) -> String {
    format!("DBB_C{number:03}")
}

/// The variables of a plan for the templates.
pub(super) fn plan_variables(plan: &Plan, language: Language, sync: Sync) -> Result<Value, Diagnostic> {
    let job = &plan.header.job;
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    Ok(context! {
        hash => printable(&plan.header.hash, 32),
        robot => printable(&robot.name, 64),
        // Comments that state the provenance.
        made => Value::from_iter(header::lines(language, &crate::artefact::made_from([&plan.traced()?]))?),
        sync => sync.name(),
        outputs => Serde(&job.motion.outputs),
        bar => Serde(&job.bar),
        settle_s => job.motion.settle_s,
    })
}

/// The frames of a plan's program for its controller, X, Y, Z, A, B, C: the tool, whose origin is the tool ball, and the base.
pub(super) fn printed_frames(motion: &MotionTable, robot: &Robot) -> [[f64; 6]; 2] {
    let [.., a, b, c] = motion.tool.unwrap_or_default();
    let [x, y, z] = robot.geometry.tool.into();
    let (tool, base) = ([x, y, z, a, b, c], motion.base.unwrap_or_default());
    let ControllerFrames { base: robot_base, flange } = &robot.frames;
    if robot.frames == ControllerFrames::default() {
        return [tool, base];
    }
    let [tool, base] = [tool, base].map(Pose::from_xyzabc);
    [flange.inverse().then(&tool).xyzabc(), robot_base.then(&base).xyzabc()]
}

/// The modules that a main module calls, each with whether the bar stays mounted before it.
pub(super) fn module_calls(modules: &[Module<'_>]) -> Value {
    let calls = modules.iter().zip(1..).map(|(module, number)| {
        let stays = module.bar == Bar::Stays;
        context! { name => name(number), stays => stays }
    });
    calls.collect()
}

/// The variables of a module for the templates. A module that no controller accepts is refused.
pub(super) fn module_variables(plan: &Plan, module: &Module<'_>) -> Result<Value, Diagnostic> {
    let (circle, dwells) = (module.circle, module.counted().count());
    if dwells > MODULE_DWELLS as usize {
        return Err(ProgramFinding::TooManyDwells { circle, dwells, most: MODULE_DWELLS }.into());
    }
    let steps = module.steps()?;
    let ball = module.ball;
    let Some(table) = plan.header.job.centres.iter().find(|table| table.id == ball) else {
        return Err(ProgramFinding::NoBall { ball }.into());
    };
    module.rows.iter().try_for_each(check_row)?;
    Ok(context! {
        circle => circle,
        ball => ball,
        stays => module.bar == Bar::Stays,
        centre => without_rotation(table.xyz_mm),
        start_deg => Serde(module.start.row.axes_deg),
        start_percent => module.start.time.axis_percent,
        steps => steps.iter().map(step_variables).collect::<Value>(),
        end_mark => module.end_mark(),
        rows => module.counted().map(|timed| timed.row.index).collect::<Value>(),
        stops => module.rows.iter().any(|timed| timed.row.kind != PoseKind::Transit),
        passes => module.rows.iter().any(|timed| timed.pass.is_some()),
    })
}

/// X, Y, Z, A, B, C of a position without rotation.
pub(super) fn without_rotation([x, y, z]: [f64; 3]) -> Value {
    Serde([x, y, z, 0.0, 0.0, 0.0]).into()
}

/// Refuses parts of a plan that only KRL supports: passes, because an arc of other controllers is shorter than a full
/// circle, and EthernetKRL.
pub(super) fn refuse_krl_only(plan: &Plan, language: Language, sync: Sync) -> Result<(), ProgramFinding> {
    let language = language.name();
    match sync {
        _ if !plan.header.passes.is_empty() => Err(ProgramFinding::NoPasses { language }),
        Sync::Ekrl { .. } => Err(ProgramFinding::NoTelegrams { language }),
        Sync::Marker | Sync::Output => Ok(()),
    }
}

/// The templates of a language.
pub(super) struct Templates(Environment<'static>);

impl Templates {
    pub(super) fn new(templates: &[(&'static str, &'static str)]) -> Result<Self, Diagnostic> {
        environment(templates).map(Self).map_err(|error| not_rendered("a program", &error))
    }

    /// Renders a file; its lines end with CR LF.
    pub(super) fn render(&self, template: &str, context: &Value) -> Result<String, Diagnostic> {
        let text = self.0.get_template(template).and_then(|template| template.render(context));
        text.map(|text| text.replace('\n', "\r\n")).map_err(|error| not_rendered(template, &error))
    }
}

fn step_variables(step: &Step<'_>) -> Value {
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
            // A dwell and a sync marker begin and end at rest; between them the robot need not be in position.
            rests => pose.kind != PoseKind::Transit || time.feed_mm_s <= MARKER_MM_S,
            dwell_s => pose.dwell_s,
            axis_percent => time.axis_percent,
            duration_s => time.duration_s,
        },
    }
}

fn environment(templates: &[(&'static str, &'static str)]) -> Result<Environment<'static>, minijinja::Error> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    let syntax =
        SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true).build()?;
    environment.set_syntax(syntax);
    environment.add_filter("mm", |value: f64| fixed(value, 3));
    environment.add_filter("deg", |value: f64| fixed(value, 4));
    environment.add_filter("speed", |value: f64| fixed(value, 6));
    environment.add_filter("seconds", |value: f64| fixed(value, 3));
    // Components of quaternions; numbers in metres and radians.
    environment.add_filter("fine", |value: f64| fixed(value, 9));
    environment.add_filter("axis", |value: f64| fixed(value, 6));
    // Numbers of a FANUC listing: positions, waits, long times, speeds.
    environment.add_filter("listed", |value: f64| format!("{:>10}", fixed(value, 3)));
    environment.add_filter("hundredths", |value: f64| format!("{:>6}", fixed(value, 2)));
    environment.add_filter("tenths", |value: f64| fixed(value, 1));
    environment.add_filter("ceiling", |value: f64| fixed(value.ceil(), 0));
    // Rounded down, because the controller would round up.
    environment.add_filter("percent", |value: f64| fixed(value.floor(), 0));
    for &(name, text) in templates {
        environment.add_template(name, text)?;
    }
    Ok(environment)
}

fn not_rendered(file: &str, error: &minijinja::Error) -> Diagnostic {
    let why = error.detail().map_or_else(|| error.to_string(), str::to_owned);
    InternalFinding::NoPage { page: file.into(), why }.into()
}

/// Refuses numbers, status and turn bits, dwells and speeds that no program can have.
fn check_row(timed: &Timed<'_>) -> Result<(), ProgramFinding> {
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
        MotionKind::Ptp if !(1.0..=100.0).contains(&percent) => {
            Err(ProgramFinding::RowAxisSpeed { row, percent })
        }
        MotionKind::Ptp => Ok(()),
        _ if timed.is_auxiliary() => Ok(()),
        _ if !(0.01..=2000.0).contains(&feed_mm_s) => Err(ProgramFinding::RowFeed { row, feed_mm_s }),
        _ if Quantity::TurnSpeed.check("", turn_deg_s).is_err() => {
            Err(ProgramFinding::RowTurn { row, turn_deg_s })
        }
        MotionKind::Lin | MotionKind::Circ => Ok(()),
    }
}

/// A text for a string or comment: printable ASCII without quotes and semicolons, at most `length` characters.
fn printable(text: &str, length: usize) -> String {
    let plain = |c: char| if c == ' ' || (c.is_ascii_graphic() && c != '"' && c != ';') { c } else { '_' };
    text.chars().map(plain).take(length).collect()
}
