//! Writes the KRL modules of a plan: one for each circle, under a master that calls them.
//!
//! A module drives to an axis position, halts for the bar to be mounted, marks its start, and goes
//! through its rows. A dwell is: arrive, settle, index on the outputs, log the measured axes, strobe
//! high while the robot stands, strobe low. A pass of a continuous circle is one such: settle, strobe high,
//! one motion, strobe low, log. All stops are exact: outputs set in the advance run
//! would come before the robot does.

mod code;
mod data;
mod ekrl;

use std::fmt;
use std::net::SocketAddrV4;

use super::number::character_text;
use crate::diag::Diagnostic;
use crate::model::{AXES, Robot};
use crate::plan::{Kind, MODULE_DWELLS, Motion, MoveTime, Pass, Plan, PlanRow};

/// Lines that a module may have: longer files are known to make trouble on old controllers.
const LINES: usize = 2000;

/// How the dwells are marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sync {
    /// By the plan's own knocks in the length alone; the program sets no output.
    Marker,
    /// By a strobe and an index on digital outputs as well.
    Output,
    /// By telegrams over EthernetKRL (KR C4 and later, an option package): dbbd is the server.
    Ekrl {
        /// Where dbbd listens, as the controller's line network sees it.
        server: SocketAddrV4,
    },
}

/// The controller's generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Controller {
    /// KR C2 (KSS 5): modules elsewhere must be declared `EXT`.
    Krc2,
    /// KR C4 (KSS 8).
    Krc4,
    /// KR C5 (KSS 8.7), the same language.
    Krc5,
}

/// What to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// How the dwells are marked.
    pub sync: Sync,
    /// The controller's generation.
    pub controller: Controller,
}

/// Why a plan has no program.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EmitError {
    /// No rows.
    #[error("the plan has no rows")]
    Empty,
    /// Times and rows do not belong together.
    #[error("the plan has {rows} rows and {moves} move times: plan.csv and plan.json do not match")]
    Moves {
        /// Rows of the plan.
        rows: usize,
        /// Entries of `moves`.
        moves: usize,
    },
    /// A row cannot be written.
    #[error("row {index}: {message}")]
    Row {
        /// The row's index.
        index: u32,
        /// Why.
        message: String,
    },
    /// A module grows too large.
    #[error("circle {circle}: {message}")]
    Circle {
        /// The circle's number.
        circle: u32,
        /// Why.
        message: String,
    },
    /// The plan's set-up cannot be written.
    #[error("{0}")]
    Setup(String),
    /// The robot in the plan.
    #[error("the robot in the plan cannot be read")]
    Robot(#[from] Diagnostic),
}

/// The modules of a plan, each a file name and its text (ASCII, CR LF). The first is the master's code.
///
/// # Errors
/// A plan that has no program in KRL: names the row or the circle and why.
pub fn emit(plan: &Plan, options: Options) -> Result<Vec<(String, String)>, EmitError> {
    if plan.rows.len() != plan.header.moves.len() {
        return Err(EmitError::Moves { rows: plan.rows.len(), moves: plan.header.moves.len() });
    }
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let writer = Writer { plan, robot: robot.controller(), options };
    let circles = writer.circles()?;
    let mut files = writer.master(&circles);
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(EmitError::Setup("EthernetKRL needs a KR C4 or later: use another sync".into()));
        }
        files.push(ekrl::channel(server));
    }
    for (at, circle) in circles.iter().enumerate() {
        files.extend(writer.module(at + 1, circle)?);
    }
    Ok(files)
}

/// A row with its time.
type Timed<'a> = (&'a PlanRow, &'a MoveTime);

/// The rows of one module.
struct Circle<'a> {
    number: u32,
    /// Where the robot drives by PTP before the bar is mounted, degrees.
    start_deg: [f64; AXES],
    /// Percent of the axis speeds for that.
    start_percent: f64,
    /// Whether the robot stands at the start already, with the bar mounted.
    mounted: bool,
    rows: Vec<Timed<'a>>,
}

/// Lines of a file.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn add(&mut self, line: impl fmt::Display) {
        self.0.push_str(&format!("{line}\r\n"));
    }

    fn all(&mut self, lines: &[&str]) {
        for line in lines {
            self.add(line);
        }
    }

    fn count(&self) -> usize {
        self.0.matches('\n').count()
    }
}

struct Writer<'a> {
    plan: &'a Plan,
    robot: &'a Robot,
    options: Options,
}

const HEAD: &[&str] =
    &["&ACCESS RVP", "&REL 1", "&PARAM EDITMASK = *", r"&PARAM TEMPLATE = C:\KRC\Roboter\Template\vorgabe"];

const INI: &[&str] = &[
    ";FOLD INI;%{PE}",
    ";FOLD BASISTECH INI",
    "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "INTERRUPT ON 3",
    "BAS (#INITMOV,0 )",
    ";ENDFOLD (BASISTECH INI)",
    ";FOLD USER INI",
    ";Make your modifications here",
    ";ENDFOLD (USER INI)",
    ";ENDFOLD (INI)",
];

impl<'a> Writer<'a> {
    /// The plan's rows by module. Rows of no circle lead to the circle after them; at the end of the
    /// plan they follow the last.
    fn circles(&self) -> Result<Vec<Circle<'a>>, EmitError> {
        let mut groups: Vec<(u32, Vec<Timed<'a>>)> = Vec::new();
        let mut leading: Vec<Timed<'a>> = Vec::new();
        let stops = self.plan.rows.iter().zip(&self.plan.header.moves).filter(|(row, _)| !row.is_passed());
        for timed in stops {
            let number = timed.0.circle;
            match groups.last_mut() {
                _ if number == 0 => leading.push(timed),
                Some((last, rows)) if *last == number => {
                    rows.append(&mut leading);
                    rows.push(timed);
                }
                _ => {
                    let mut rows = std::mem::take(&mut leading);
                    rows.push(timed);
                    groups.push((number, rows));
                }
            }
        }
        match groups.last_mut() {
            Some((_, rows)) => rows.append(&mut leading),
            None => return Err(EmitError::Empty),
        }
        let mut circles: Vec<Circle<'a>> = Vec::new();
        for (number, mut rows) in groups {
            let before = circles.last().and_then(|circle| circle.rows.last().copied());
            let leads = |timed: &&Timed<'a>| timed.0.motion == Motion::Ptp && timed.0.kind == Kind::Transit;
            let leading = rows.iter().take_while(leads).count();
            let first = rows.first().copied().ok_or(EmitError::Empty)?;
            let (start, mounted) = match (leading.checked_sub(1).and_then(|at| rows.get(at)), before) {
                (Some(start), _) => (*start, false),
                (None, _) if first.0.motion == Motion::Ptp => (first, false),
                // The bar stays mounted from the circle before: the robot stands at the start already.
                (None, Some(before)) if before.0.centre == first.0.centre => (before, true),
                (None, _) => {
                    let message = "a program must begin with a PTP to where the bar is mounted".into();
                    return Err(EmitError::Row { index: first.0.index, message });
                }
            };
            // A start where the robot stands already: the bar stays on its ball.
            let stands = |timed: Timed<'a>| {
                let apart = timed.0.axes_deg.iter().zip(&start.0.axes_deg).map(|(a, b)| (a - b).abs());
                timed.0.centre == first.0.centre && apart.fold(0.0, f64::max) < 1e-3
            };
            let mounted = mounted || before.is_some_and(stands);
            // The last of the leading transits is the start itself; those before it stay as via points.
            if leading > 0 {
                rows.remove(leading - 1);
            }
            circles.push(Circle {
                number,
                start_deg: start.0.axes_deg,
                start_percent: start.1.axis_percent,
                mounted,
                rows,
            });
        }
        Ok(circles)
    }

    /// The pass that ends at a row.
    fn pass(&self, end: &PlanRow) -> Option<&'a Pass> {
        self.plan.header.passes.iter().find(|pass| pass.end == end.index)
    }

    /// Whether a row has a number of its own in its module: a dwell, or the end of a pass.
    fn is_told(&self, row: &PlanRow) -> bool {
        row.kind != Kind::Transit || self.pass(row).is_some()
    }

    fn external(&self) -> &'static [&'static str] {
        match self.options.controller {
            Controller::Krc2 => &[
                ";FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P",
                ";FOLD BASISTECH EXT;%{PE}%MKUKATPBASIS,%CEXT,%VEXT,%P",
                "EXT BAS (BAS_COMMAND :IN,REAL :IN )",
                "DECL INT SUCCESS",
                ";ENDFOLD (BASISTECH EXT)",
                ";ENDFOLD (EXTERNAL DECLARATIONS)",
            ],
            Controller::Krc4 | Controller::Krc5 => &[],
        }
    }

    /// `DBB_MAIN`, which calls the circles.
    fn master(&self, circles: &[Circle<'_>]) -> Vec<(String, String)> {
        let mut source = Lines::default();
        source.all(HEAD);
        source.add("DEF DBB_MAIN ( )");
        if self.options.controller == Controller::Krc2 {
            for at in 1..=circles.len() {
                source.add(format!("EXT DBB_C{at:03} ( )"));
            }
        }
        source.all(INI);
        source.add(format!("; ball-bar calibration, plan {}", self.hash()));
        for (at, circle) in circles.iter().enumerate() {
            if at > 0 && !circle.mounted {
                source.add("; take the ball bar off now, then press START");
                source.add("HALT");
            }
            source.add(format!("DBB_C{:03} ( )", at + 1));
        }
        source.add("END");
        let mut data = Lines::default();
        data.all(HEAD);
        data.add("DEFDAT DBB_MAIN");
        data.all(self.external());
        self.identity(&mut data);
        data.add("ENDDAT");
        vec![("DBB_MAIN.src".into(), source.0), ("DBB_MAIN.dat".into(), data.0)]
    }

    fn hash(&self) -> String {
        character_text(&self.plan.header.hash, 32)
    }

    /// Which plan and robot the program is for.
    fn identity(&self, data: &mut Lines) {
        let robot = character_text(&self.robot.name, 64);
        data.add(format!("; ball-bar calibration, plan {}, robot {robot}", self.hash()));
        for (name, text) in [("DBBPLAN", self.hash()), ("DBBROBOT", robot)] {
            data.add(format!("DECL CHAR {name}[{}]", text.len().max(1)));
            data.add(format!("{name}[]=\"{text}\""));
        }
    }

    fn module(&self, at: usize, circle: &Circle<'_>) -> Result<Vec<(String, String)>, EmitError> {
        let name = format!("DBB_C{at:03}");
        let refuse = |message: String| EmitError::Circle { circle: circle.number, message };
        let dwells = circle.rows.iter().filter(|(row, _)| self.is_told(row)).count();
        if dwells > MODULE_DWELLS as usize {
            return Err(refuse(format!(
                "{dwells} dwells are too many: a module has at most {MODULE_DWELLS}"
            )));
        }
        let centre = circle.rows.first().map_or(0, |(row, _)| row.centre);
        if let Some((row, _)) = circle.rows.iter().find(|(row, _)| row.centre != centre) {
            let message = format!("ball {} in a circle about ball {centre}", row.centre);
            return Err(EmitError::Row { index: row.index, message });
        }
        let mut source = Lines::default();
        self.code(&mut source, &name, circle, centre)?;
        let mut data = Lines::default();
        self.data(&mut data, &name, circle, centre, dwells)?;
        for lines in [&source, &data] {
            if lines.count() > LINES {
                return Err(refuse(format!("{} lines are too many for a module", lines.count())));
            }
        }
        Ok(vec![(format!("{name}.src"), source.0), (format!("{name}.dat"), data.0)])
    }
}
