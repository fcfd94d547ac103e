//! Writes the KRL modules of a plan: one for each circle, under a master that calls them.
//!
//! A module drives to an axis position, halts for the bar to be mounted, marks its start, and goes through its rows. A
//! dwell is: arrive, settle, index on the outputs, log the measured axes, strobe high while the robot is at rest, strobe
//! low. A pass of a continuous circle is one such: settle, strobe high, one motion, strobe low, log. All stops are
//! exact: outputs set in the advance run would come before the robot does.

mod code;
mod data;
mod ekrl;
mod number;

use std::fmt;
use std::net::SocketAddrV4;

pub(super) use number::fixed;

use self::number::character_text;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::{MODULE_DWELLS, Plan};
use crate::program::krl::header;
use crate::program::sequence::{Bar, Module, modules};
use crate::provenance::Provenance;
use crate::robot::Robot;

/// Lines that a module may have: longer files are known to make trouble on old controllers.
const LINES: usize = 2000;

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

/// The modules of a plan, each a file name and its text (ASCII, CR LF). The first is the master's code.
pub fn emit(plan: &Plan, options: Options) -> Result<Vec<(String, String)>, Diagnostic> {
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let made = header::lines(&Provenance::of([&plan.traced()?]))?;
    let writer = Writer { plan, robot: robot.controller(), options, made };
    let modules = modules(plan)?;
    let mut files = writer.master(&modules);
    if let Sync::Ekrl { server } = options.sync {
        if options.controller == Controller::Krc2 {
            return Err(ProgramFinding::NoEthernetKrl.into());
        }
        files.push(ekrl::channel(server));
    }
    for (at, module) in modules.iter().enumerate() {
        files.extend(writer.module(&format!("DBB_C{:03}", at + 1), module)?);
    }
    Ok(files)
}

#[derive(Default)]
struct Lines(String);

impl Lines {
    fn add(&mut self, line: impl fmt::Display) {
        self.0.push_str(&format!("{line}\r\n"));
    }

    fn all(&mut self, lines: &[impl fmt::Display]) {
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
    /// Comments that say what the program was made from.
    made: Vec<String>,
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

impl Writer<'_> {
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
            Controller::Krc4 | Controller::Krc5 | Controller::Simulated => &[],
        }
    }

    /// `DBB_MAIN`, which calls the circles.
    fn master(&self, modules: &[Module<'_>]) -> Vec<(String, String)> {
        let mut source = Lines::default();
        source.all(HEAD);
        source.add("DEF DBB_MAIN ( )");
        source.all(&self.made);
        if self.options.controller == Controller::Krc2 {
            for at in 1..=modules.len() {
                source.add(format!("EXT DBB_C{at:03} ( )"));
            }
        }
        source.all(INI);
        source.add(format!("; ball-bar calibration, plan {}", self.hash()));
        for (at, module) in modules.iter().enumerate() {
            if at > 0 && module.bar == Bar::ToBeMounted {
                source.add("; take the ball bar off now, then press START");
                source.add("HALT");
            }
            source.add(format!("DBB_C{:03} ( )", at + 1));
        }
        source.add("END");
        let mut data = Lines::default();
        data.all(HEAD);
        data.add("DEFDAT DBB_MAIN");
        data.all(&self.made);
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

    fn module(&self, name: &str, module: &Module<'_>) -> Result<[(String, String); 2], Diagnostic> {
        let (circle, dwells) = (module.circle, module.counted().count());
        if dwells > MODULE_DWELLS as usize {
            return Err(ProgramFinding::TooManyDwells { circle, dwells, most: MODULE_DWELLS }.into());
        }
        let (source, data) = (self.code(name, module)?, self.data(name, module)?);
        let lines = source.count().max(data.count());
        if lines > LINES {
            return Err(ProgramFinding::TooManyLines { circle, lines, most: LINES }.into());
        }
        Ok([(format!("{name}.src"), source.0), (format!("{name}.dat"), data.0)])
    }
}
